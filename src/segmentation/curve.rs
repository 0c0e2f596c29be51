//! Facets of one curved surface become a sphere or a cylinder.
//!
//! Growth by planes leaves a curved surface in facets, each as wide as the noise lets a plane be.
//! Two neighbouring facets determine a cylinder (its axis is perpendicular to both normals) and a
//! sphere. Where such a guess explains both facets it grows over the sticks around it, and it
//! replaces what was there if it explains the same readings at a lower price.

use super::config::ShapeLimits;
use super::facets::Facets;
use super::field::Field;
use super::fit::{Model, Readings, improve_model, settle_model};
use super::grow::Grower;
use super::guess::Guesser;
use super::noise::ReadingErrors;
use super::sticks::{Stick, Sticks};
use nalgebra::Vector3;

/// Price of a surface in units of the noise variance: its parameters and its outline.
const PRICE: f64 = 30.0;
/// Price of a reading that no surface explains.
const UNEXPLAINED: f64 = 4.0;
/// Mean square error up to which a guess from two facets is followed.
const GUESS_ERROR: f64 = 4.0;
/// Angles between the normals of two facets of a curved surface, as cosines: 4° to 75°.
const SMALLEST_TURN: f64 = 0.9976;
const LARGEST_TURN: f64 = 0.26;
/// Radius in metres up to which a guess is held to nothing: facets of small things are merged to wider ones.
const SMALL_M: f64 = 2.0;
/// Times that the radius of the circle through two facets may be as large as their distance and turn have it.
const ROOM: f64 = 3.0;
/// Gate of the growth in standard deviations of what is compared, and what is always allowed in
/// standard deviations of one reading.
const GATE: f64 = 3.0;
const SLACK: f64 = 0.7;
/// A region this many times larger than a guess does not lose sticks to it.
const UNTOUCHABLE: f64 = 4.0;
/// Most rounds of growing and fitting.
const ROUNDS: usize = 5;
/// Least cosine of incidence that is believed.
const LEAST_COSINE: f64 = 0.1;

/// Most sticks of a facet that a guess looks at, evenly taken.
const GUESS_STICKS: usize = 20;
/// Guesses that are looked at, the largest first: real scans have clutter that falls into any number
/// of facets, and the cost is to grow with the points alone.
const FEWEST_GUESSES: usize = 64;
const CELLS_PER_GUESS: usize = 128;

/// Whether a stick fits the model at hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    Not,
    Fits,
    Refused,
}

/// Buffers of the search.
#[derive(Clone, Debug, Default)]
pub(super) struct CurveFinder {
    facets: Facets,
    guesses: Vec<(f64, u32, u32)>,
    guesser: Guesser,
    readings: Readings,
    set: Vec<u32>,
    refused: Vec<u32>,
    /// What is known of each stick while a set grows.
    asked: Vec<Asked>,
    shares: Vec<(u32, f64)>,
    trust: ReadingErrors,
    /// Curved surface of each region, where it is one.
    pub models: Vec<Option<Model>>,
}

impl CurveFinder {
    /// Replaces facets by curved surfaces in the grower's regions; new regions come last.
    pub fn find(
        &mut self,
        field: &Field,
        sticks: &Sticks,
        grower: &mut Grower,
        limits: &ShapeLimits,
    ) {
        self.trust = field.errors;
        self.models.clear();
        self.models.resize(grower.regions.len(), None);
        self.facets.load(sticks, grower);
        self.asked.clear();
        self.asked.resize(sticks.sticks.len(), Asked::Not);
        self.collect_guesses(grower, limits);
        self.guesses.truncate(FEWEST_GUESSES + field.len() / CELLS_PER_GUESS);
        for k in 0..self.guesses.len() {
            let (_, a, b) = self.guesses[k];
            // Facets that an earlier guess has taken are gone.
            if self.facets.left[a as usize] == 0 || self.facets.left[b as usize] == 0 {
                continue;
            }
            if let Some((model, facets)) = self.best_guess(sticks, grower, a, b, limits) {
                self.pursue(sticks, grower, facets, model, limits);
            }
        }
    }

    /// Pairs of facets that turn, the largest first.
    fn collect_guesses(&mut self, grower: &Grower, limits: &ShapeLimits) {
        self.guesses.clear();
        for &(a, b) in &grower.merger.pairs {
            let may_curve = |region| self.facets.may_curve(region, limits.max_radius_m);
            if !may_curve(a) || !may_curve(b) || !self.facets.meet(a, b) {
                continue;
            }
            let (first, second) = (&grower.regions[a as usize], &grower.regions[b as usize]);
            let (qa, qb) = (Vector3::from(first.plane.q), Vector3::from(second.plane.q));
            let cosine = qa.dot(&qb) / (qa.norm() * qb.norm());
            // A facet on one lane has no normal of its own, so nothing is known of the turn.
            let free = self.facets.is_one_lane(a) || self.facets.is_one_lane(b);
            let bends = || {
                // As wide as they are for the circle through both, with room for what noise turns them by.
                let radius_m = self.facets.apart_m(a, b) / (2.0 * (1.0 - cosine)).sqrt();
                let may_curve =
                    |region| self.facets.may_curve(region, (ROOM * radius_m).max(SMALL_M));
                may_curve(a) && may_curve(b)
            };
            if free || (LARGEST_TURN < cosine && cosine < SMALLEST_TURN && bends()) {
                let n = first.moments.n + second.moments.n;
                self.guesses.push((n, a, b));
            }
        }
        self.guesses.sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    }

    /// The sphere or cylinder that explains two facets, or, where these have one lane each, which
    /// leaves the circle open, or two, whose plane is hardly known, the best that explains them and a
    /// third beside them.
    fn best_guess(
        &mut self,
        sticks: &Sticks,
        grower: &Grower,
        a: u32,
        b: u32,
        limits: &ShapeLimits,
    ) -> Option<(Model, [u32; 3])> {
        if !(self.facets.is_one_lane(a) && self.facets.is_one_lane(b)) {
            if let Some(guess) = self.guess(sticks, grower, [a, b, b], limits) {
                return Some((guess.1, [a, b, b]));
            }
            if !(self.facets.is_narrow(a) && self.facets.is_narrow(b)) {
                return None;
            }
        }
        let mut best: Option<(f64, Model, [u32; 3])> = None;
        let around_a = self.facets.near(a).len();
        for k in 0..around_a + self.facets.near(b).len() {
            let third = match k.checked_sub(around_a) {
                None => self.facets.near(a)[k],
                Some(k) => self.facets.near(b)[k],
            };
            let spans = [a, b, third].map(|region| self.facets.lanes(region));
            if self.facets.left[third as usize] == 0
                || !self.facets.is_narrow(third)
                || spans[2] == spans[0]
                || spans[2] == spans[1]
            {
                continue;
            }
            if let Some((error, model)) = self.guess(sticks, grower, [a, b, third], limits)
                && best.as_ref().is_none_or(|best| error < best.0)
            {
                best = Some((error, model, [a, b, third]));
            }
        }
        best.map(|(_, model, facets)| (model, facets))
    }

    /// The sphere or cylinder that explains the facets, and its mean square error. A facet named
    /// twice counts once.
    fn guess(
        &mut self,
        sticks: &Sticks,
        grower: &Grower,
        facets: [u32; 3],
        limits: &ShapeLimits,
    ) -> Option<(f64, Model)> {
        let [a, b, c] = facets;
        self.guesser.clear();
        for &region in &facets[..if c == b { 2 } else { 3 }] {
            let members = self.facets.sticks(region);
            let stride = members.len().div_ceil(GUESS_STICKS).max(1);
            for &s in members.iter().step_by(stride) {
                if grower.region_of[s as usize] == region {
                    let stick = &sticks.sticks[s as usize];
                    let gain = stick.weight / common_of_half(stick, &self.trust);
                    stick.ends.iter().for_each(|&end| self.guesser.push(end, gain));
                }
            }
            if !self.guesser.end_facet() {
                return None;
            }
        }
        self.guesser.prepare();
        let [qa, qb] = [a, b].map(|r| Vector3::from(grower.regions[r as usize].plane.q));
        let axis = qa.cross(&qb).try_normalize(1e-12);
        let spread = self.guesser.principal_axis();
        let mut best: Option<(f64, Model)> = None;
        for candidate in [axis.map(Some), Some(Some(spread)), Some(None)].into_iter().flatten() {
            // Each stick end stands for several readings, so a good guess has an error of one.
            let enough = best.as_ref().map_or(GUESS_ERROR, |best| best.0);
            let found = match candidate {
                Some(axis) => self.guesser.cylinder(axis, enough),
                None => self.guesser.sphere(enough),
            };
            let Some((error, model)) = found else { continue };
            let Some(radius_m) = model.radius_m() else { continue };
            if radius_m <= limits.max_radius_m
                && facets.iter().all(|&facet| self.facets.may_curve(facet, radius_m.max(SMALL_M)))
            {
                best = Some((error, model));
            }
        }
        best
    }

    /// Grows a guess and installs it if it is worth its price.
    fn pursue(
        &mut self,
        sticks: &Sticks,
        grower: &mut Grower,
        facets: [u32; 3],
        mut model: Model,
        limits: &ShapeLimits,
    ) {
        let mut before = 0;
        for _ in 0..ROUNDS {
            self.grow(sticks, grower, facets, &model);
            if self.set.len() == before {
                break;
            }
            before = self.set.len();
            let set = self.set.iter().map(|&s| &sticks.sticks[s as usize]);
            self.readings.gather_pairs(set.map(|stick| readings_of(stick, &self.trust)));
            let refined = improve_model(&self.readings, &model);
            let Some(refined) = refined else { return };
            model = refined;
        }
        // Errors across the surface bias the radius by σ² / R; those along the rays do not.
        let Some(model) = settle_model(&self.readings, &model, limits, &self.trust) else { return };
        let Some(radius_m) = model.radius_m() else { return };
        if radius_m > limits.max_radius_m || !self.is_worth_it(sticks, grower, &model) {
            return;
        }
        self.install(sticks, grower, model);
    }

    /// The connected sticks that fit a model, from the sticks of the facets on.
    fn grow(&mut self, sticks: &Sticks, grower: &Grower, facets: [u32; 3], model: &Model) {
        self.set.clear();
        self.refused.clear();
        let mut readings = 0.0;
        for facet in facets {
            for &s in self.facets.sticks(facet) {
                let asked = &mut self.asked[s as usize];
                if grower.region_of[s as usize] != facet || *asked != Asked::Not {
                    continue;
                }
                let stick = &sticks.sticks[s as usize];
                if fits(model, stick, &self.trust) {
                    self.set.push(s);
                    *asked = Asked::Fits;
                    readings += stick.n;
                } else {
                    self.refused.push(s);
                    *asked = Asked::Refused;
                }
            }
        }
        let mut at = 0;
        while at < self.set.len() {
            let stick = self.set[at];
            at += 1;
            for range in sticks.around(stick) {
                for s in range {
                    let asked = &mut self.asked[s as usize];
                    if *asked != Asked::Not {
                        continue;
                    }
                    let region = grower.region_of[s as usize];
                    let owner = grower.regions[region as usize].moments.n;
                    if self.models[region as usize].is_some()
                        || (region != 0 && owner >= UNTOUCHABLE * readings)
                    {
                        continue;
                    }
                    let other = &sticks.sticks[s as usize];
                    if fits(model, other, &self.trust) {
                        self.set.push(s);
                        *asked = Asked::Fits;
                        readings += other.n;
                    } else {
                        // Several of the set touch it.
                        self.refused.push(s);
                        *asked = Asked::Refused;
                    }
                }
            }
        }
        for &s in self.set.iter().chain(&self.refused) {
            self.asked[s as usize] = Asked::Not;
        }
    }

    /// Whether the model explains its sticks at a lower price than what explains them now.
    fn is_worth_it(&mut self, sticks: &Sticks, grower: &Grower, model: &Model) -> bool {
        self.shares.clear();
        let readings = self.set.iter().map(|&s| sticks.sticks[s as usize].n).sum();
        let price = self.trust.price(PRICE, readings);
        let (mut before, mut after) = (0.0, price);
        for &s in &self.set {
            let stick = &sticks.sticks[s as usize];
            after += stick_error(model, stick);
            let region = grower.region_of[s as usize];
            if region == 0 {
                before += UNEXPLAINED * stick.n;
                continue;
            }
            let q = grower.regions[region as usize].plane.q;
            let error: f64 = stick
                .ends
                .iter()
                .map(|p| stick.weight * (q[0] * p[0] + q[1] * p[1] + q[2] * p[2] - 1.0).powi(2))
                .sum();
            before += error.min(UNEXPLAINED * stick.n);
            match self.shares.iter_mut().find(|share| share.0 == region) {
                Some(share) => share.1 += stick.n,
                None => self.shares.push((region, stick.n)),
            }
        }
        for &(region, n) in &self.shares {
            before += price * (n / grower.regions[region as usize].moments.n).min(1.0);
        }
        after < before
    }

    fn install(&mut self, sticks: &Sticks, grower: &mut Grower, model: Model) {
        let label = grower.regions.len() as u32;
        let mut region = super::grow::Region::default();
        for &s in &self.set {
            let stick = &sticks.sticks[s as usize];
            stick.add_to(&mut region.moments);
            let owner = grower.region_of[s as usize];
            if owner != 0 {
                self.facets.left[owner as usize] -= 1;
            }
            grower.region_of[s as usize] = label;
        }
        region.plane = super::grow::Plane::of(&region.moments);
        grower.regions.push(region);
        self.models.push(Some(model));
    }
}

/// Variance of the mean of half a stick's readings in units of what it were if each had its own error.
fn common_of_half(stick: &Stick, errors: &ReadingErrors) -> f64 {
    errors.mean_variance(0.5 * stick.n) * 0.5 * stick.n
}

/// A stick as two points whose standard deviations are those of half its cells.
fn readings_of(stick: &Stick, errors: &ReadingErrors) -> [([f64; 3], f64); 2] {
    let per_range = (common_of_half(stick, errors) / stick.weight).sqrt();
    stick.ends.map(|end| (end, Vector3::from(end).norm() * per_range))
}

/// Error of an end of a stick, relative to the range.
#[inline]
fn deviation(model: &Model, end: [f64; 3]) -> f64 {
    let p = Vector3::from(end);
    let range = p.norm();
    let (distance, normal) = model.distance(&p);
    // The cosine of incidence is that of the normal and the ray, times the range.
    distance / normal.dot(&p).abs().max(LEAST_COSINE * range)
}

fn fits(model: &Model, stick: &Stick, errors: &ReadingErrors) -> bool {
    let gate = GATE * errors.mean_variance(0.5 * stick.n).sqrt() + SLACK;
    stick.ends.iter().all(|&end| {
        let p = Vector3::from(end);
        let Some((radial, radius_m)) = model.radial(&p) else {
            return (deviation(model, end) * stick.root_gain).abs() < gate;
        };
        // As the deviation has it, times the distance from the axis or the centre: nothing is divided.
        let (length, bound) = (radial.norm(), gate * radial.dot(&p).abs());
        let error = (length - radius_m).abs() * length * stick.root_gain;
        // Whether less than the cosine of incidence is believed is only asked where that decides.
        error < bound || error < gate * LEAST_COSINE * p.norm() * length
    })
}

fn stick_error(model: &Model, stick: &Stick) -> f64 {
    stick.ends.iter().map(|&end| stick.weight * deviation(model, end).powi(2)).sum()
}
