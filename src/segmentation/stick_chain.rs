//! The default structure.

use super::compete::{Competition, NO_RETURN, Rival};
use super::config::SegmentationConfig;
use super::curve::CurveFinder;
use super::field::Field;
use super::fit::Model;
use super::grow::Grower;
use super::merge::Merger;
use super::moments::Moments;
use super::sticks::Sticks;
use super::{Stage, StageImage};

/// How far a plane moves, root mean square over its readings in units of their noise, before borders
/// to it are settled again.
const MOVED: f64 = 0.2;

/// What a chain knows of its labels.
pub(super) struct Found<'a> {
    /// The sums of each label.
    pub moments: &'a [Moments],
    /// The curved surface of each label, where it was found to be one; none at all from a chain that
    /// does not look for them.
    pub models: &'a [Option<Model>],
}

/// Buffers and stage images of the chain.
#[derive(Clone, Debug, Default)]
pub(super) struct StickChain {
    sticks: Sticks,
    grower: Grower,
    curves: CurveFinder,
    rivals: Vec<Rival>,
    competition: Competition,
    moments: Vec<Moments>,
    /// Labels whose plane became another since the borders were settled.
    changed: Vec<bool>,
    merger: Merger,
}

impl StickChain {
    /// Finds the regions of a field; `labels` gets one number to each, 0 for none and [`NO_RETURN`] for cells
    /// without a return. Returns what is known of them.
    pub fn run(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        labels: &mut Vec<u32>,
        observe: &mut dyn FnMut(Stage),
    ) -> Found<'_> {
        observe(Stage::Residual);
        self.sticks.cut(field);
        observe(Stage::Morphology);
        self.grower.grow(field, &self.sticks);
        self.curves.find(field, &self.sticks, &mut self.grower, &config.limits);
        let region_of = &self.grower.region_of;
        self.sticks.paint(field, |stick| region_of[stick], NO_RETURN, labels);
        observe(Stage::Fill);
        self.rivals.clear();
        for (region, model) in self.grower.regions.iter().zip(&self.curves.models) {
            self.rivals.push(match model {
                Some(model) => Rival::of(model),
                None => Rival::Plane(region.plane.q.map(|v| v as f32)),
            });
        }
        self.competition.settle(field, &self.rivals, labels);
        self.merge(field, labels);
        self.competition.settle_again(field, &self.rivals, labels, &self.changed);
        observe(Stage::Split);
        Found { moments: &self.moments, models: &self.curves.models }
    }

    /// Merges planes that touch now that the cells are settled, and fits them anew.
    fn merge(&mut self, field: &Field, labels: &mut [u32]) {
        self.moments.clear();
        self.moments.extend(self.grower.regions.iter().map(|region| region.moments));
        for (&cell, &before) in self.competition.border.iter().zip(&self.competition.before) {
            let cell = cell as usize;
            let now = labels[cell];
            if before != now {
                let (point, weight) = (field.point(cell), field.weight(cell));
                self.moments[before as usize].sub_point(point, weight);
                self.moments[now as usize].add_point(point, weight);
            }
        }
        let (count, border) = (self.moments.len(), &self.competition.border);
        self.merger.pairs_of_labels(labels, count, field.lanes, &field.rim, border);
        let models = &self.curves.models;
        self.merger
            .merge(&mut self.moments, &field.lane_errors, |label| models[label as usize].is_none());
        self.merger.follow(labels);
        self.changed.clear();
        self.changed.resize(self.rivals.len(), false);
        for (label, rival) in self.rivals.iter_mut().enumerate() {
            if let Rival::Plane(q) = rival {
                let moments = &self.moments[label];
                let solved = moments.solve();
                let moved: [f64; 3] = std::array::from_fn(|i| solved[i] - f64::from(q[i]));
                self.changed[label] = self.merger.has_grown(label as u32)
                    || moments.square(&moved) > MOVED * MOVED * moments.n;
                *q = solved.map(|v| v as f32);
            }
        }
    }

    /// The stages as pictures, in field order; `labels` are those that the chain found.
    pub fn images(&self, field: &Field, labels: &[u32]) -> Vec<StageImage> {
        let (mut sticks, mut grown) = (Vec::new(), Vec::new());
        let mut painter = self.sticks.clone();
        painter.paint(field, |stick| stick as u32 + 1, 0, &mut sticks);
        painter.paint(field, |stick| self.grower.region_of[stick], 0, &mut grown);
        let settled = labels.iter().map(|&label| if label == NO_RETURN { 0 } else { label });
        vec![
            StageImage::labels("sticks", sticks),
            StageImage::labels("grown", grown),
            StageImage::labels("settled", settled.collect()),
        ]
    }
}
