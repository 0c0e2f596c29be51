//! Figures 3 and 6: a mission's map of planes from above and at a slant, and how compact it is beside
//! the points it came from and an octree of them.

use crate::driver::simulated::SimulatedMission;
use crate::export::canvas::{Canvas, Colour};
use crate::export::map_scene::{add_landmark, add_path, surface_colour};
use crate::export::map3d;
use crate::export::scene3d::{Camera, Scene};
use crate::files::scenario::LoadedScenario;
use crate::mapping::Landmark;
use crate::scan::RangeImage;
use anyhow::{Context, Result};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::Serialize;
use std::collections::BTreeSet;

/// Edge of the octree's leaves in metres, and levels above them.
const LEAF_M: f64 = 0.05;
const LEVELS: u32 = 16;
/// Bytes of a point: three 32-bit numbers.
const POINT_BYTES: usize = 12;
/// Bytes of an inner node of the most compact octree file in use (OctoMap's `.bt`): two bits a child.
const NODE_BYTES: usize = 2;
/// Bytes of a landmark but for its outline and mask: seven 32-bit numbers of a frame, six of a
/// covariance, an identity.
const LANDMARK_BYTES: usize = 56;
/// Bytes of a corner of an outline, and of a tile of 8 × 8 mask cells with its place.
const CORNER_BYTES: usize = 8;
const TILE_BYTES: usize = 12;

/// The same surfaces in three forms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Compactness {
    /// Planes of the map.
    pub elements: usize,
    /// Accepted associations of the mission.
    pub associations: usize,
    /// Bytes of the map: frames, covariances, outlines and masks.
    pub map_bytes: usize,
    /// Bytes of frames and outlines alone, which is what the paper's map holds.
    pub outline_bytes: usize,
    /// Points of all sweeps.
    pub points: usize,
    /// Bytes of the points.
    pub cloud_bytes: usize,
    /// Occupied leaves of the octree.
    pub octree_leaves: usize,
    /// Bytes of the octree, its occupied part alone.
    pub octree_bytes: usize,
}

/// What a run gives.
pub struct MapFigures {
    /// From above.
    pub fig3: Canvas,
    /// At a slant.
    pub fig6: Canvas,
    /// Bytes and elements.
    pub compactness: Compactness,
}

/// Runs a scenario and draws its map.
///
/// # Errors
///
/// A scenario whose parts do not fit.
pub fn map_figures(loaded: LoadedScenario) -> Result<MapFigures> {
    let mut mission = SimulatedMission::new(loaded, std::io::sink())?;
    let mut cloud = Cloud::default();
    let mut taken = 0;
    while mission.step()? {
        let Some(running) = mission.agent().running() else { continue };
        let belief = running.belief();
        if let Some((keyframe, image)) = belief.last_sweep().filter(|(k, _)| *k >= taken) {
            taken = keyframe + 1;
            cloud.add(image, &belief.world_from_robot());
        }
    }
    let running = mission.agent().running().context("the mission ended before it began")?;
    let belief = running.belief();
    let landmarks = belief.mapper().landmarks();
    let path: Vec<Isometry3<f64>> = belief.trajectory().into_iter().map(|(_, pose)| pose).collect();
    let shape = running.shape();
    let size = Vector3::new(shape.length_m, shape.width_m, shape.height_m);
    let mut compactness = cloud.compactness();
    compactness.elements = landmarks.len();
    compactness.associations = running.ledger().associations;
    for landmark in landmarks {
        let outline = LANDMARK_BYTES + CORNER_BYTES * landmark.hull.len();
        compactness.outline_bytes += outline;
        compactness.map_bytes += outline + TILE_BYTES * landmark.mask.tiles();
    }
    Ok(MapFigures {
        fig3: from_above(landmarks, &path),
        fig6: map3d::draw(landmarks, belief.mapper().curves(), &belief.grid(), &path, &size),
        compactness,
    })
}

/// The points of a mission, counted and sorted into leaves.
#[derive(Default)]
struct Cloud {
    points: usize,
    leaves: BTreeSet<[i32; 3]>,
}

impl Cloud {
    fn add(&mut self, image: &RangeImage, world_from_robot: &Isometry3<f64>) {
        for row in 0..image.rows().len() {
            for column in 0..image.columns() {
                let Some(point) = image.point(row, column) else { continue };
                let point = world_from_robot * image.robot_from_scan * point;
                self.points += 1;
                let leaf = |x: f64| (x / LEAF_M).floor() as i32;
                self.leaves.insert([leaf(point.x), leaf(point.y), leaf(point.z)]);
            }
        }
    }

    fn compactness(&self) -> Compactness {
        let mut inner = 0;
        let mut level = self.leaves.clone();
        for _ in 0..LEVELS {
            level = level.into_iter().map(|cell| cell.map(|x| x.div_euclid(2))).collect();
            inner += level.len();
        }
        Compactness {
            points: self.points,
            cloud_bytes: POINT_BYTES * self.points,
            octree_leaves: self.leaves.len(),
            octree_bytes: NODE_BYTES * inner,
            ..Compactness::default()
        }
    }
}

/// The map from straight above, without ceilings, as the paper's figure 3.
fn from_above(landmarks: &[Landmark], path: &[Isometry3<f64>]) -> Canvas {
    const WIDTH: usize = 1400;
    const HEIGHT: usize = 1000;
    let mut scene = Scene::new();
    for landmark in landmarks.iter().filter(|landmark| landmark.normal().z > -0.7) {
        let colour = surface_colour(&landmark.normal(), landmark.origin().z);
        add_landmark(&mut scene, landmark, colour);
    }
    add_path(&mut scene, path, 3.0, Colour::rgb(0, 90, 220));
    let (low, high) =
        scene.bounds().unwrap_or((Point3::new(-1.0, -1.0, 0.0), Point3::new(1.0, 1.0, 1.0)));
    let camera = Camera::above(low, high, WIDTH as f64 / HEIGHT as f64);
    scene.render(&camera, WIDTH, HEIGHT, Colour::rgb(236, 239, 244))
}

impl Compactness {
    /// The figures for people.
    pub fn text(&self) -> String {
        let kilo = |bytes: usize| bytes as f64 / 1000.0;
        let times = |bytes: usize| bytes as f64 / self.map_bytes.max(1) as f64;
        format!(
            "map     {:>9.1} kB  {} planes with outlines and masks, {} associations \
             (outlines alone {:.1} kB)\n\
             octree  {:>9.1} kB  {} leaves of 0.05 m, {:.1} times the map\n\
             cloud   {:>9.1} kB  {} points, {:.1} times the map\n",
            kilo(self.map_bytes),
            self.elements,
            self.associations,
            kilo(self.outline_bytes),
            kilo(self.octree_bytes),
            self.octree_leaves,
            times(self.octree_bytes),
            kilo(self.cloud_bytes),
            self.points,
            times(self.cloud_bytes)
        )
    }
}
