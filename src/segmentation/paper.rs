//! The paper's chain (section III), each stage in a module of its own.
//!
//! Residual of the local least-squares plane, scaled by the noise, edges where it is too large,
//! morphology, flood fill, a check by local normals; then, because borders are as thick as the
//! residual's window, the cells at a border join the surface that they fit.

use super::absorb::Absorber;
use super::axes::candidate_axes;
use super::borders::Borders;
use super::compete::NO_RETURN;
use super::components::Components;
use super::config::{PaperConfig, SegmentationConfig};
use super::field::Field;
use super::fill::flood_fill;
use super::fit::{Columns, Fitted, Model, Readings, choose};
use super::merge::Merger;
use super::moments::Moments;
use super::morphology::Morphology;
use super::residual::{Residual, scale};
use super::split::Splitter;
use super::stick_chain::Found;
use super::{Stage, StageImage};

/// Residual that is white in the scaled image, in standard deviations.
const WHITE: f32 = 6.0;
/// Residual that is white in the picture of the plain one, in metres.
const WHITE_M: f32 = 0.05;
/// Fewest cells that a filled region needs to get a preliminary model.
const FEWEST_CELLS: usize = 12;

/// Buffers and stage images of the chain.
#[derive(Clone, Debug, Default)]
pub(super) struct PaperChain {
    residual: Residual,
    grey: Vec<u8>,
    edges: Vec<u8>,
    mask: Vec<u8>,
    open: Vec<u8>,
    morphology: Morphology,
    filled: Vec<u32>,
    parted: Vec<u32>,
    sizes: Vec<usize>,
    stack: Vec<u32>,
    splitter: Splitter,
    components: Components,
    readings: Readings,
    models: Vec<Option<Model>>,
    absorber: Absorber,
    merger: Merger,
    moments: Vec<Moments>,
    flat: Vec<bool>,
    borders: Borders,
    border: Vec<u32>,
}

impl PaperChain {
    /// Finds the regions of a field; `labels` gets one number to each, 0 for none and [`NO_RETURN`] for cells
    /// without a return. Returns what is known of them.
    pub fn run(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        labels: &mut Vec<u32>,
        observe: &mut dyn FnMut(Stage),
    ) -> Found<'_> {
        let paper = &config.paper;
        let width = field.lanes;
        self.residual.compute(field);
        scale(&self.residual.scaled, WHITE, &mut self.grey);
        observe(Stage::Residual);
        self.find_edges(field, paper);
        observe(Stage::Morphology);
        flood_fill(&self.open, width, labels, &mut self.sizes, &mut self.stack);
        self.filled.clone_from(labels);
        observe(Stage::Fill);
        if paper.split_by_normals {
            let last = self.sizes.len() as u32;
            self.splitter.split(field, labels, last, paper.split_angle_deg.to_radians());
        }
        self.parted.clone_from(labels);
        let count = labels.iter().max().map_or(0, |&most| most as usize + 1);
        self.components.find(labels, (width, count));
        self.fit_models(field, config);
        labels.fill(0);
        for (run, component) in self.components.all_runs() {
            if self.models[component].is_some() {
                labels[run].fill(component as u32 + 1);
            }
        }
        self.absorber.absorb(
            field,
            &self.models,
            labels,
            paper.absorb_deviations,
            paper.absorb_rings,
        );
        self.flat.clear();
        self.flat.extend(self.models.iter().map(|m| matches!(m, Some(Model::Plane { .. }))));
        self.merge(field, labels);
        observe(Stage::Split);
        for (cell, label) in labels.iter_mut().enumerate() {
            *label = if field.is_valid(cell) { *label } else { NO_RETURN };
        }
        Found { moments: &self.moments, models: &[] }
    }

    fn find_edges(&mut self, field: &Field, paper: &PaperConfig) {
        let width = field.lanes;
        let deviation = (2.0 / self.residual.freedom()).sqrt();
        let threshold = (1.0 + paper.edge_deviations * deviation).sqrt() as f32;
        self.edges.clear();
        self.edges.extend(self.residual.scaled.iter().map(|&s| u8::from(s > threshold)));
        self.mask.clone_from(&self.edges);
        self.morphology.close(&mut self.mask, width);
        self.morphology.drop_specks(&mut self.mask, width, paper.min_edge_cells);
        self.open.clear();
        self.open.extend(
            (0..field.len()).map(|cell| u8::from(self.mask[cell] == 0 && field.is_valid(cell))),
        );
    }

    /// A preliminary model for each region that is large enough.
    fn fit_models(&mut self, field: &Field, config: &SegmentationConfig) {
        self.models.clear();
        for component in 0..self.components.len() {
            let count = self.components.sizes[component];
            if count < FEWEST_CELLS {
                self.models.push(None);
                continue;
            }
            let cells = self.components.cells(component);
            let columns = Columns::of(field, &field.gain);
            self.readings.gather_runs(columns, &field.range, self.components.runs(component));
            let belongs = |c: usize| self.components.of(c) == Some(component);
            let axes = candidate_axes(field, cells, count, belongs);
            let (fitted, _) = choose(&mut self.readings, &axes, &config.limits, &field.errors);
            self.models.push(match fitted {
                Fitted::Plane(plane) => Some(plane.model()),
                Fitted::Sphere { centre, radius_m, .. } => {
                    Some(Model::Sphere { centre: centre.coords, radius_m })
                }
                Fitted::Cylinder { axis_point, axis, radius_m, .. } => Some(Model::Cylinder {
                    foot: axis_point.coords,
                    axis: axis.into_inner(),
                    radius_m,
                }),
                Fitted::Other => None,
            });
        }
    }

    /// Merges planar regions that touch and lie on one plane.
    fn merge(&mut self, field: &Field, labels: &mut [u32]) {
        self.moments.clear();
        self.moments.resize(self.models.len() + 1, Moments::default());
        for (cell, &label) in labels.iter().enumerate() {
            if label != 0 {
                let weight = field.weight(cell);
                self.moments[label as usize].add_point(field.point(cell), weight);
            }
        }
        let count = self.moments.len();
        self.borders.find(labels, (field.lanes, count), &mut self.border);
        self.merger.pairs_of_labels(labels, count, field.lanes, &field.rim, &self.border);
        let flat = &self.flat;
        self.merger.merge(&mut self.moments, &field.errors, |label| flat[label as usize - 1]);
        self.merger.follow(labels);
    }

    /// The stages as pictures, in field order.
    pub fn images(&self, field: &Field) -> Vec<StageImage> {
        let bytes = |mask: &[u8]| mask.iter().map(|&m| 255 * m).collect();
        let residuals = (0..self.residual.scaled.len())
            .map(|cell| self.residual.scaled[cell] * field.sigma_m(cell) as f32);
        let mut plain = Vec::new();
        scale(&residuals.collect::<Vec<f32>>(), WHITE_M, &mut plain);
        vec![
            StageImage::grey("residual", plain),
            StageImage::grey("scaled", self.grey.clone()),
            StageImage::grey("edges", bytes(&self.edges)),
            StageImage::grey("morphology", bytes(&self.mask)),
            StageImage::labels("fill", self.filled.clone()),
            StageImage::labels("split", self.parted.clone()),
        ]
    }
}
