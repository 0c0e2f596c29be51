//! `map3d.png`: the map in three dimensions for people.

use super::canvas::{Canvas, Colour};
use super::map_scene::{add_landmark, add_path, add_robot, surface_colour};
use super::scene3d::{Camera, Scene};
use crate::mapping::Landmark;
use crate::terrain::{CellClass, Grid};
use nalgebra::{Isometry3, Point3, Vector3};

const WIDTH: usize = 1400;
const HEIGHT: usize = 900;

/// Draws patches, drop-offs and the path from above at a slant. Ceilings are left out, and so are
/// walls seen from behind: the picture looks into the rooms.
pub fn draw(
    landmarks: &[Landmark],
    grid: &Grid,
    trajectory: &[Isometry3<f64>],
    robot_size_m: &Vector3<f64>,
) -> Canvas {
    let mut bounds = Scene::new();
    let mut scene = Scene::new();
    for landmark in landmarks {
        if landmark.normal().z > -0.7 {
            add_landmark(&mut bounds, landmark, Colour::BLACK);
        }
    }
    add_path(&mut bounds, trajectory, 1.0, Colour::BLACK);
    let (low, high) =
        bounds.bounds().unwrap_or((Point3::new(-1.0, -1.0, 0.0), Point3::new(1.0, 1.0, 1.0)));
    let camera = closest(low, high, -1.9, 0.75);
    for landmark in landmarks {
        let normal = landmark.normal();
        let towards_eye = camera.eye - landmark.origin();
        if normal.z > -0.7 && normal.dot(&towards_eye) > 0.0 {
            add_landmark(&mut scene, landmark, surface_colour(&normal, landmark.origin().z));
        }
    }
    add_edges(&mut scene, grid);
    add_path(&mut scene, trajectory, 3.0, Colour::rgb(0, 90, 220));
    if let Some(pose) = trajectory.last() {
        add_robot(&mut scene, pose, robot_size_m, Colour::rgb(230, 160, 0));
    }
    let mut canvas = scene.render(&camera, WIDTH, HEIGHT, Colour::rgb(236, 239, 244));
    let legend = "patches by height: blue low, yellow, red high; floors grey; red squares: \
                  drop-offs; blue line: path";
    canvas.text(12.0, 10.0, 1, legend, Colour::BLACK);
    canvas
}

/// The camera from a direction that shows the box `low..high` as large as the picture allows.
fn closest(low: Point3<f64>, high: Point3<f64>, azimuth_rad: f64, elevation_rad: f64) -> Camera {
    let wide = Camera::around(low, high, azimuth_rad, elevation_rad);
    let corner = |i: usize| {
        let pick = |bit: usize, a: f64, b: f64| if i >> bit & 1 == 0 { a } else { b };
        Point3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
    };
    let fits = |camera: &Camera| {
        (0..8).all(|i| {
            camera.pixel(&corner(i), WIDTH, HEIGHT).is_some_and(|p| {
                let (margin, top) = (20.0, 30.0);
                (margin..WIDTH as f64 - margin).contains(&p.x)
                    && (top..HEIGHT as f64 - margin).contains(&p.y)
            })
        })
    };
    let at = |share: f64| Camera { eye: wide.target + (wide.eye - wide.target) * share, ..wide };
    // The nearest that fits, by halving between too near and the one that certainly fits.
    let (mut near, mut far) = (0.05, 1.0);
    for _ in 0..20 {
        let middle = 0.5 * (near + far);
        if fits(&at(middle)) {
            far = middle;
        } else {
            near = middle;
        }
    }
    at(far)
}

/// Drop-offs as red squares at the height of the ground beside them.
fn add_edges(scene: &mut Scene, grid: &Grid) {
    let red = Colour::rgb(230, 0, 30);
    let half = 0.5 * grid.cell_m();
    for (cell, what) in grid.iter().filter(|(_, what)| what.class == CellClass::DropOff) {
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().find_map(|(dx, dy)| {
            let next = crate::terrain::CellIndex { x: cell.x + dx, y: cell.y + dy };
            let height = grid.get(next).height_m;
            height.is_finite().then_some(f64::from(height))
        });
        let own = what.height_m.is_finite().then(|| f64::from(what.height_m));
        let Some(z) = beside.or(own) else { continue };
        let c = grid.centre(cell);
        let corner = |sx: f64, sy: f64| Point3::new(c.x + sx * half, c.y + sy * half, z + 0.02);
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        scene.polygon(&corners, red);
    }
}
