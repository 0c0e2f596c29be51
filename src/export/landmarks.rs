//! Landmarks of a map as JSON and as polygons.

use super::map_scene::{mask_rectangles, surface_colour};
use super::ply;
use crate::mapping::{CurveKind, CurvedLandmark, Landmark, Mapper};
use nalgebra::{Point2, Point3, SMatrix, Vector3};
use serde_json::{Value, json};

/// A matrix as a list of rows.
pub fn rows<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// Sides of the polygons that stand for a curved body in pictures and meshes.
const SIDES: usize = 16;

/// The surfaces of a map as `surfaces.json` lists them: planes first, then curved bodies, whose ids go
/// on from those of the planes.
pub fn surfaces_json(mapper: &Mapper) -> Vec<Value> {
    let planes = mapper.landmarks().iter().map(landmark_json);
    let first = mapper.landmarks().last().map_or(0, |landmark| landmark.id.0 + 1);
    let curves = mapper.curves().iter().zip(first..).map(|(curve, id)| curve_json(curve, id));
    planes.chain(curves).collect()
}

/// The surfaces of a map as polygons, coloured by how they lie.
pub fn surface_polygons(mapper: &Mapper) -> Vec<ply::Polygon> {
    let there = mapper.landmarks().iter().filter(|landmark| !landmark.gone);
    let planes = there.flat_map(landmark_polygons);
    let sides = mapper.curves().iter().flat_map(curve_sides).map(|(vertices, normal)| {
        let colour = surface_colour(&normal, vertices[0].z);
        ply::Polygon { vertices, colour: [colour.red, colour.green, colour.blue] }
    });
    planes.chain(sides).collect()
}

/// The sides of a curved body as quadrilaterals, each with its normal to the outside.
pub fn curve_sides(curve: &CurvedLandmark) -> Vec<(Vec<Point3<f64>>, Vector3<f64>)> {
    let [lower, upper] = curve.rims(SIDES);
    (0..SIDES)
        .map(|i| {
            let next = (i + 1) % SIDES;
            let corners = vec![lower[i], lower[next], upper[next], upper[i]];
            let normal = (lower[next] - lower[i]).cross(&(upper[i] - lower[i]));
            (corners, normal.try_normalize(1e-12).unwrap_or_default())
        })
        .collect()
}

fn curve_json(curve: &CurvedLandmark, id: u32) -> Value {
    let frame = &curve.world_from_curve;
    let origin = frame.translation.vector;
    let mut value = json!({
        "id": id,
        "sightings": curve.sightings,
        "points": curve.points,
        "rms_m": curve.rms_m,
        "radius_m": curve.radius_m,
    });
    match curve.kind {
        CurveKind::Cylinder => {
            let axis = frame.rotation * Vector3::z();
            value["kind"] = json!("cylinder");
            value["axis_point"] =
                json!(origin + axis * (0.5 * (curve.along_m.0 + curve.along_m.1)));
            value["axis"] = json!(axis);
            value["length_m"] = json!(curve.along_m.1 - curve.along_m.0);
        }
        CurveKind::Sphere => {
            value["kind"] = json!("sphere");
            value["centre"] = json!(origin);
        }
    }
    value
}

/// A landmark as `surfaces.json` lists it.
fn landmark_json(landmark: &Landmark) -> Value {
    let plane = landmark.plane();
    json!({
        "id": landmark.id.0,
        "kind": "plane",
        "sightings": landmark.sightings,
        "gone": landmark.gone,
        "points": landmark.points,
        "rms_m": landmark.rms_m,
        "normal": plane.normal,
        "offset_m": plane.offset_m,
        "centroid": landmark.origin(),
        "hull": landmark.hull_points().collect::<Vec<_>>(),
        "area_m2": landmark.area_m2(),
        "mask": landmark_rectangles(landmark),
        "mask_area_m2": landmark.mask.area_m2(),
        "covariance": rows(&landmark.covariance),
    })
}

/// The cells of a landmark that were hit as rectangles, in the world: within its hull doorways are open.
fn landmark_rectangles(landmark: &Landmark) -> Vec<[Point3<f64>; 4]> {
    let place = |p: Point2<f64>| landmark.world_from_plane * Point3::new(p.x, p.y, 0.0);
    mask_rectangles(&landmark.mask).into_iter().map(|corners| corners.map(place)).collect()
}

/// What was hit of a landmark, or its hull where no cells are known, coloured by how it lies.
fn landmark_polygons(landmark: &Landmark) -> Vec<ply::Polygon> {
    let colour = surface_colour(&landmark.normal(), landmark.origin().z);
    let colour = [colour.red, colour.green, colour.blue];
    let polygon = |vertices: Vec<Point3<f64>>| ply::Polygon { vertices, colour };
    if landmark.mask.is_empty() {
        return vec![polygon(landmark.hull_points().collect())];
    }
    landmark_rectangles(landmark).into_iter().map(|corners| polygon(corners.to_vec())).collect()
}
