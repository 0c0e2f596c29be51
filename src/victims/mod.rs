//! Victim candidates: sightings of body parts gathered by place, with the evidence for each.
//!
//! A false alarm is reported exactly like one body part (protocol document 7.4). A person shows
//! several different parts close to one another, from more than one place; that is what confirms.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Parts of one body lie within this distance of their middle.
const BODY_RADIUS_M: f64 = 0.9;

/// Confirmed candidates within this distance are one body to whoever looks for it: sightings from far
/// away scatter by more than a body is wide, and the rules count a report within 1.5 m as found.
const ONE_BODY_M: f64 = 1.5;

/// When a candidate counts as a victim.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VictimConfig {
    /// Different body parts that must have been seen. [1, 7]
    pub least_parts: usize,
    /// Sightings that must have come in. [1, 100]
    pub least_sightings: usize,
}

impl Default for VictimConfig {
    fn default() -> Self {
        Self { least_parts: 2, least_sightings: 3 }
    }
}

/// A place where body parts were seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Mean of the sightings, nearer ones counting more, in the map frame.
    pub place: Point3<f64>,
    /// How often each kind of part was seen.
    pub parts: BTreeMap<String, usize>,
    /// Number of sightings.
    pub sightings: usize,
    /// Sum of the weights in `place`.
    weight: f64,
}

impl Candidate {
    /// Whether the evidence is that of a person.
    pub fn is_confirmed(&self, config: &VictimConfig) -> bool {
        self.parts.len() >= config.least_parts && self.sightings >= config.least_sightings
    }
}

/// All candidates so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Candidates {
    found: Vec<Candidate>,
}

impl Candidates {
    /// Takes in one body part seen at `place` (map frame) from `distance_m` away. The error of a
    /// sighting grows with the distance, 5 % of it on each axis, so its weight falls with the square.
    pub fn sight(&mut self, part: &str, place: Point3<f64>, distance_m: f64) {
        let weight = 1.0 / (0.05 * distance_m.max(0.5)).powi(2);
        let near = self
            .found
            .iter_mut()
            .map(|candidate| ((candidate.place - place).xy().norm(), candidate))
            .filter(|(away, _)| *away <= BODY_RADIUS_M)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let candidate = match near {
            Some((_, candidate)) => candidate,
            None => {
                self.found.push(Candidate {
                    place,
                    parts: BTreeMap::new(),
                    sightings: 0,
                    weight: 0.0,
                });
                self.found.last_mut().expect("one was pushed on the line before")
            }
        };
        candidate.weight += weight;
        candidate.place += (place - candidate.place) * (weight / candidate.weight);
        *candidate.parts.entry(part.to_owned()).or_default() += 1;
        candidate.sightings += 1;
    }

    /// All candidates in the order of their first sighting.
    pub fn all(&self) -> &[Candidate] {
        &self.found
    }

    /// The candidates that count as victims.
    pub fn confirmed(&self, config: &VictimConfig) -> impl Iterator<Item = &Candidate> {
        let config = *config;
        self.found.iter().filter(move |candidate| candidate.is_confirmed(&config))
    }

    /// The candidates that count as victims, those close together taken as one.
    pub fn bodies(&self, config: &VictimConfig) -> Vec<Candidate> {
        let mut bodies: Vec<Candidate> = Vec::new();
        for candidate in self.confirmed(config) {
            let near = bodies
                .iter_mut()
                .find(|body| (body.place - candidate.place).xy().norm() <= ONE_BODY_M);
            let Some(body) = near else {
                bodies.push(candidate.clone());
                continue;
            };
            body.weight += candidate.weight;
            body.place += (candidate.place - body.place) * (candidate.weight / body.weight);
            body.sightings += candidate.sightings;
            for (part, count) in &candidate.parts {
                *body.parts.entry(part.clone()).or_default() += count;
            }
        }
        bodies
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_parts_make_a_victim_and_one_part_does_not() {
        let mut candidates = Candidates::default();
        for i in 0..9 {
            candidates.sight("Leg", Point3::new(2.0, 1.0 + 0.01 * f64::from(i), 0.1), 2.0);
            candidates.sight("Chest", Point3::new(8.0, 0.0, 0.1), 3.0);
        }
        candidates.sight("Arm", Point3::new(2.5, 1.2, 0.2), 2.0);
        let config = VictimConfig::default();
        let confirmed: Vec<_> = candidates.confirmed(&config).collect();
        assert_eq!(candidates.all().len(), 2);
        assert_eq!(confirmed.len(), 1);
        assert!((confirmed[0].place - Point3::new(2.05, 1.05, 0.1)).norm() < 0.1);
    }

    #[test]
    fn candidates_about_one_body_are_one_and_the_next_body_is_another() {
        let mut candidates = Candidates::default();
        for x in [0.0, 1.0, 6.0] {
            for part in ["Leg", "Arm", "Head"] {
                candidates.sight(part, Point3::new(x, 0.0, 0.1), 2.0);
            }
        }
        let config = VictimConfig::default();
        assert_eq!(candidates.confirmed(&config).count(), 3);
        let bodies = candidates.bodies(&config);
        assert_eq!(bodies.len(), 2);
        assert!((bodies[0].place.x - 0.5).abs() < 1e-9 && bodies[0].sightings == 6);
        assert_eq!(bodies[0].parts["Leg"], 2);
    }

    #[test]
    fn a_near_sighting_outweighs_a_far_one() {
        let mut candidates = Candidates::default();
        candidates.sight("Head", Point3::new(0.5, 0.0, 0.0), 4.0);
        candidates.sight("Head", Point3::new(0.0, 0.0, 0.0), 1.0);
        assert!(candidates.all()[0].place.x < 0.05);
    }
}
