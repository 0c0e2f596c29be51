//! From an organised scan to fitted surfaces with covariances and hulls.
//!
//! [`Segmenter::segment`] turns a [`PointGrid`] into a [`Segmentation`]: a label image and, for each
//! label, a plane with its hull, a sphere or a cylinder, each with the covariance that its readings
//! and their noise give. The noise is estimated from the scan and the grid's geometry inferred from
//! its points.

mod absorb;
mod around;
mod assemble;
mod axes;
mod borders;
mod compete;
mod components;
mod config;
mod curve;
mod cut;
mod doubt;
mod facets;
mod field;
mod fill;
mod fit;
mod grow;
mod guess;
mod hull;
mod merge;
mod moments;
mod morphology;
mod near;
mod noise;
mod noise_estimate;
mod noise_filing;
mod noise_model;
mod outermost;
mod pairs;
mod paper;
mod positions;
mod residual;
mod run;
mod segments;
mod split;
mod stick_chain;
mod sticks;
mod surface;
mod turns;
mod unevenness;
mod vectors;

pub use config::{Method, PaperConfig, SegmentationConfig, ShapeLimits};
pub use noise::{RangeNoise, ReadingErrors};
pub use surface::{Cylinder, PlanePatch, Rejected, Segmentation, Shape, Sphere, Surface};

use crate::scan::PointGrid;
use assemble::Assembler;
use field::Field;
use noise_estimate::NoiseEstimator;
use paper::PaperChain;
use stick_chain::StickChain;

/// The stages of the chain, in the order in which they end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Loading, noise, residuals.
    Residual,
    /// Edges and their morphology.
    Morphology,
    /// Regions of connected smooth cells.
    Fill,
    /// Regions parted where they leaked, borders given to the surface they fit.
    Split,
    /// Shapes fitted and chosen.
    Fit,
    /// Hulls, labels and the result.
    Hull,
}

/// What a stage left behind, as a picture of the grid's size.
#[derive(Clone, Debug, PartialEq)]
pub struct StageImage {
    /// Name of the stage, fit for a file name.
    pub name: &'static str,
    /// Its pixels, row by row of the grid.
    pub pixels: StagePixels,
}

/// Pixels of a [`StageImage`].
#[derive(Clone, Debug, PartialEq)]
pub enum StagePixels {
    /// Grey levels.
    Grey(Vec<u8>),
    /// Region numbers, 0 for none.
    Labels(Vec<u32>),
}

impl StageImage {
    fn grey(name: &'static str, pixels: Vec<u8>) -> Self {
        Self { name, pixels: StagePixels::Grey(pixels) }
    }

    fn labels(name: &'static str, labels: Vec<u32>) -> Self {
        Self { name, pixels: StagePixels::Labels(labels) }
    }

    /// The picture in the order of the grid instead of the field's.
    fn in_grid_order(self, field: &Field) -> Self {
        fn reorder<T: Copy + Default>(field: &Field, pixels: &[T]) -> Vec<T> {
            let mut ordered = vec![T::default(); pixels.len()];
            for (cell, &pixel) in pixels.iter().enumerate() {
                ordered[field.grid_index(cell)] = pixel;
            }
            ordered
        }
        let pixels = match &self.pixels {
            StagePixels::Grey(pixels) => StagePixels::Grey(reorder(field, pixels)),
            StagePixels::Labels(labels) => StagePixels::Labels(reorder(field, labels)),
        };
        Self { name: self.name, pixels }
    }
}

/// Segments scans. Its buffers are kept from one scan to the next.
#[derive(Clone, Debug, Default)]
pub struct Segmenter {
    config: SegmentationConfig,
    field: Field,
    noise_estimator: NoiseEstimator,
    paper: PaperChain,
    sticks: StickChain,
    labels: Vec<u32>,
    assembler: Assembler,
    result: Segmentation,
}

impl Segmenter {
    /// A segmenter with the given settings.
    pub fn new(config: SegmentationConfig) -> Self {
        Self { config, ..Self::default() }
    }

    /// Segments a scan. The frame of the result is that of the grid, whose origin is taken as the
    /// viewpoint; rows may have been taken from a few centimetres beside it.
    ///
    /// The result is kept until the next call. A scan without any surface is an ordinary result.
    pub fn segment(&mut self, grid: &PointGrid) -> &Segmentation {
        self.segment_observed(grid, &mut |_| ())
    }

    /// As [`segment`](Self::segment), calling `observe` at the end of each stage: this module has no
    /// clock of its own.
    pub fn segment_observed(
        &mut self,
        grid: &PointGrid,
        observe: &mut dyn FnMut(Stage),
    ) -> &Segmentation {
        self.field.load(grid);
        let errors = match self.config.range_sigma_m {
            Some(sigma_m) => ReadingErrors::independent(RangeNoise::uniform(sigma_m)),
            None => self.noise_estimator.estimate(&self.field),
        };
        let errors = self.with_rounding(errors, grid);
        self.field.set_errors(errors);
        let found = match self.config.method {
            Method::Paper => self.paper.run(&self.field, &self.config, &mut self.labels, observe),
            Method::Sticks => self.sticks.run(&self.field, &self.config, &mut self.labels, observe),
        };
        self.assembler.assemble(
            &self.field,
            &self.config,
            (&self.labels, found),
            (grid.rows(), grid.columns()),
            &mut self.result,
            observe,
        );
        &self.result
    }

    /// What readings err by if their ranges are cut to a grid.
    fn with_rounding(&self, errors: ReadingErrors, grid: &PointGrid) -> ReadingErrors {
        let Some(rounding) = grid.rounding() else { return errors };
        let [down, right, patch] = rounding.runs(grid.columns());
        let run = if self.field.transposed { right } else { down };
        let [nearest, _] = self.field.extent;
        errors.cut(rounding, (run, patch), f64::from(nearest))
    }

    /// The last result, empty before the first scan.
    pub fn result(&self) -> &Segmentation {
        &self.result
    }

    /// The noise of the ranges that the last scan was segmented with.
    pub fn noise(&self) -> RangeNoise {
        self.field.errors.noise
    }

    /// The errors of the readings that the last scan was segmented with.
    pub fn errors(&self) -> ReadingErrors {
        self.field.errors
    }

    /// The stages of the last scan as pictures.
    pub fn stage_images(&self) -> Vec<StageImage> {
        let images = match self.config.method {
            Method::Paper => self.paper.images(&self.field),
            Method::Sticks => self.sticks.images(&self.field, &self.labels),
        };
        images.into_iter().map(|image| image.in_grid_order(&self.field)).collect()
    }
}
