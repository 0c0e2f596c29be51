//! Landmarks of a map as JSON and as polygons.

use super::map_scene::surface_colour;
use super::ply;
use crate::mapping::Landmark;
use nalgebra::SMatrix;
use serde_json::{Value, json};

/// A matrix as a list of rows.
pub fn rows<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// A landmark as `surfaces.json` lists it.
pub fn landmark_json(landmark: &Landmark) -> Value {
    let plane = landmark.plane();
    json!({
        "id": landmark.id.0,
        "kind": "plane",
        "sightings": landmark.sightings,
        "points": landmark.points,
        "rms_m": landmark.rms_m,
        "normal": plane.normal,
        "offset_m": plane.offset_m,
        "centroid": landmark.origin(),
        "hull": landmark.hull_points().collect::<Vec<_>>(),
        "area_m2": landmark.area_m2(),
        "mask_area_m2": landmark.mask.area_m2(),
        "covariance": rows(&landmark.covariance),
    })
}

/// A landmark's hull, coloured by how it lies.
pub fn landmark_polygon(landmark: &Landmark) -> ply::Polygon {
    let colour = surface_colour(&landmark.normal(), landmark.origin().z);
    ply::Polygon {
        vertices: landmark.hull_points().collect(),
        colour: [colour.red, colour.green, colour.blue],
    }
}
