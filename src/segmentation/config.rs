use serde::{Deserialize, Serialize};

/// Which structure finds the regions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Lines of the grid cut into sticks, sticks grown to regions, borders settled cell by cell.
    #[default]
    Sticks,
    /// The paper's chain: residual image, morphology, flood fill, check by normals.
    Paper,
}

/// Settings of the segmentation. The noise and the grid's geometry are measured, not set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentationConfig {
    /// Which structure finds the regions.
    pub method: Method,
    /// Fewest points of a region that becomes a surface, 3 or more.
    pub min_points: usize,
    /// Standard deviation of the ranges in metres, above zero; estimated from each scan where it is
    /// not given.
    pub range_sigma_m: Option<f64>,
    /// What a sphere or cylinder must be to be believed.
    pub limits: ShapeLimits,
    /// The paper's chain.
    pub paper: PaperConfig,
}

impl Default for SegmentationConfig {
    fn default() -> Self {
        Self {
            method: Method::default(),
            min_points: 40,
            range_sigma_m: None,
            limits: ShapeLimits::default(),
            paper: PaperConfig::default(),
        }
    }
}

/// Settings of the paper's chain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperConfig {
    /// A cell is an edge where its mean square residual is this many of its own standard deviations
    /// above what noise gives, above zero.
    pub edge_deviations: f64,
    /// Edges of fewer cells than this are noise, 0 or more.
    pub min_edge_cells: usize,
    /// Whether regions are split where local normals differ.
    pub split_by_normals: bool,
    /// Angle between neighbouring local normals that parts a region, in degrees, 0 to 90.
    pub split_angle_deg: f64,
    /// Error up to which a border cell joins a region beside it, in standard deviations, above zero.
    pub absorb_deviations: f64,
    /// Cells that a region may grow by at its border, 0 or more.
    pub absorb_rings: usize,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            edge_deviations: 5.0,
            min_edge_cells: 4,
            split_by_normals: true,
            split_angle_deg: 20.0,
            absorb_deviations: 3.0,
            absorb_rings: 8,
        }
    }
}

/// What a sphere or cylinder must be to be believed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapeLimits {
    /// Greatest radius of a sphere or cylinder in metres, above zero.
    pub max_radius_m: f64,
    /// Least part of a cylinder's circle that must be seen, in degrees, 0 to 180. Of a radius above two
    /// metres it is enough that noise leaves it open by a hundredth of itself.
    pub min_arc_deg: f64,
    /// Least angle from the middle of a sphere's visible cap to its border, in degrees, 0 to 90; of a large
    /// radius as for a cylinder.
    pub min_cap_deg: f64,
    /// Mean square error, in units of the noise, beyond which no model describes a region, above 1.
    pub max_mean_square: f64,
}

impl Default for ShapeLimits {
    fn default() -> Self {
        Self { max_radius_m: 30.0, min_arc_deg: 60.0, min_cap_deg: 30.0, max_mean_square: 9.0 }
    }
}
