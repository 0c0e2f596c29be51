//! `map3d.png`: the map in three dimensions for people.

use super::canvas::{Canvas, Colour};
use super::landmarks::curve_sides;
use super::map_scene::{add_landmark, add_path, add_robot, surface_colour};
use super::scene3d::{Camera, FIELD_OF_VIEW_RAD, Scene};
use crate::mapping::{CurvedLandmark, Landmark};
use crate::terrain::{CellClass, CellIndex, Grid};
use nalgebra::{Isometry3, Point3, Vector3};
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

const WIDTH: usize = 1400;
const HEIGHT: usize = 900;
/// Border of the picture in pixels; above there is a line of text too.
const MARGIN_PX: f64 = 20.0;
const TOP_PX: f64 = 34.0;

/// Direction to the eye: how far above the horizon, and how far beside the middle of the longer side.
const ELEVATION_RAD: f64 = 0.85;
const ASIDE_RAD: f64 = 0.33;

/// At least this far about the robot is shown, in metres: else a robot that has seen nothing would
/// fill the picture.
const LEAST_ABOUT_M: f64 = 2.0;

/// Height of the ground beside a drop-off is sought this many cells away.
const BESIDE_CELLS: i32 = 8;

const GROUND: Colour = Colour::rgb(205, 212, 200);
const OBSTACLE: Colour = Colour::rgb(150, 140, 175);
const EDGE: Colour = Colour::rgb(230, 0, 30);
const PATH: Colour = Colour::rgb(0, 90, 220);
const ROBOT: Colour = Colour::rgb(230, 160, 0);

/// Draws patches, curved bodies, drop-offs and the path from above at a slant. Ceilings are left
/// out, and so are walls seen from behind: the picture looks into the rooms. A map without patches,
/// as that of a laser that does not tilt, shows the grid's obstacles as columns up to the robot's
/// height.
pub fn draw(
    landmarks: &[Landmark],
    curves: &[CurvedLandmark],
    grid: &Grid,
    trajectory: &[Isometry3<f64>],
    robot_size_m: &Vector3<f64>,
) -> Canvas {
    let is_shown = |landmark: &&Landmark| !landmark.gone && landmark.normal().z > -0.7;
    let mut whole = Scene::new();
    for landmark in landmarks.iter().filter(is_shown) {
        add_landmark(&mut whole, landmark, Colour::BLACK);
    }
    for (side, _) in curves.iter().flat_map(curve_sides) {
        whole.polygon(&side, Colour::BLACK);
    }
    add_path(&mut whole, trajectory, 1.0, Colour::BLACK);
    let robot = trajectory.last().copied().unwrap_or_default();
    let floor_z = robot.translation.z;
    if landmarks.is_empty() {
        add_grid(&mut whole, grid, floor_z, floor_z + robot_size_m.z);
    }
    let mut outline: Vec<Point3<f64>> = whole.points().copied().collect();
    for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        let aside = Vector3::new(x, y, 0.0) * LEAST_ABOUT_M;
        outline.push(Point3::from(robot.translation.vector + aside));
    }
    let (camera, rows) = framed(&outline);
    let mut scene = Scene::new();
    for landmark in landmarks.iter().filter(is_shown) {
        let normal = landmark.normal();
        if normal.dot(&(camera.eye - landmark.origin())) > 0.0 {
            add_landmark(&mut scene, landmark, surface_colour(&normal, landmark.origin().z));
        }
    }
    for (side, normal) in curves.iter().flat_map(curve_sides) {
        let middle = nalgebra::center(&side[0], &side[2]);
        if normal.dot(&(camera.eye - middle)) > 0.0 {
            scene.polygon(&side, surface_colour(&normal, middle.z));
        }
    }
    if landmarks.is_empty() {
        add_grid(&mut scene, grid, floor_z, floor_z + robot_size_m.z);
    }
    add_edges(&mut scene, grid);
    add_path(&mut scene, trajectory, 3.0, PATH);
    if !trajectory.is_empty() {
        add_robot(&mut scene, &robot, robot_size_m, ROBOT);
    }
    let picture = scene.render(&camera, WIDTH, HEIGHT, Colour::rgb(236, 239, 244));
    let mut canvas = picture.rows(rows);
    let legend = if landmarks.is_empty() {
        "no patches: columns are obstacles of the grid, as high as the robot; pale: free; red: \
         drop-offs; blue line: path; orange: robot"
    } else {
        "patches by height: blue low, yellow, red high; floors grey; red: drop-offs; blue line: \
         path; orange: robot"
    };
    canvas.text(12.0, 10.0, 1, legend, Colour::BLACK);
    canvas
}

/// A camera at a slant that shows all of `points` as large as the picture allows, and the rows of the
/// picture that they take up. The longer side lies across.
fn framed(points: &[Point3<f64>]) -> (Camera, Range<usize>) {
    let (mut low, mut high) = (points[0], points[0]);
    for p in points {
        (low, high) = (low.inf(p), high.sup(p));
    }
    let across = if high.y - low.y > high.x - low.x { 0.0 } else { -FRAC_PI_2 };
    let mut camera = Camera::around(low, high, across - ASIDE_RAD, ELEVATION_RAD);
    let towards_eye = (camera.eye - camera.target).normalize();
    let right = camera.up.cross(&towards_eye).normalize();
    let up = towards_eye.cross(&right);
    let mut away_m = (camera.eye - camera.target).norm();
    let room = [WIDTH as f64 - 2.0 * MARGIN_PX, HEIGHT as f64 - TOP_PX - MARGIN_PX];
    let middle = [0.5 * WIDTH as f64, 0.5 * (HEIGHT as f64 + TOP_PX - MARGIN_PX)];
    // Moving aside and nearing change each other's effect a little, so both are done in turns.
    let mut extent = [0.0; 4];
    for round in 0..40 {
        let Some(seen) = extent_px(&camera, points) else {
            away_m *= 1.5;
            camera.eye = camera.target + towards_eye * away_m;
            continue;
        };
        extent = seen;
        let [left, right_px, top, bottom] = seen;
        let fill = ((right_px - left) / room[0]).max((bottom - top) / room[1]);
        if round > 30 && fill <= 1.0 {
            break;
        }
        let metres_a_pixel = away_m * f64::tan(0.5 * FIELD_OF_VIEW_RAD) / (0.5 * HEIGHT as f64);
        camera.target += right * ((0.5 * (left + right_px) - middle[0]) * metres_a_pixel);
        camera.target -= up * ((0.5 * (top + bottom) - middle[1]) * metres_a_pixel);
        away_m *= fill.clamp(0.5, 2.0);
        camera.eye = camera.target + towards_eye * away_m;
    }
    let first = (extent[2] - TOP_PX).clamp(0.0, HEIGHT as f64 - 1.0) as usize;
    let end = ((extent[3] + MARGIN_PX).ceil() as usize).clamp(first + 1, HEIGHT);
    (camera, first..end)
}

/// Left, right, top and bottom of what is seen of the points; `None` if one is behind the eye.
fn extent_px(camera: &Camera, points: &[Point3<f64>]) -> Option<[f64; 4]> {
    let mut extent = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    for p in camera.pixels(points, WIDTH, HEIGHT) {
        let p = p?;
        extent = [extent[0].min(p.x), extent[1].max(p.x), extent[2].min(p.y), extent[3].max(p.y)];
    }
    Some(extent)
}

/// The grid itself: ground as flat runs of cells, obstacles as columns from `floor_z` to `top_z`.
fn add_grid(scene: &mut Scene, grid: &Grid, floor_z: f64, top_z: f64) {
    let is_ground = |class: CellClass| {
        matches!(class, CellClass::Free | CellClass::Assumed | CellClass::FlatFree)
    };
    let half = 0.5 * grid.cell_m();
    for row in grid.cells().chunks(grid.width().max(1)).enumerate() {
        let (y, cells) = (row.0 as i32, row.1);
        let mut x = 0;
        while x < cells.len() {
            let run = cells[x..].iter().take_while(|cell| is_ground(cell.class)).count();
            if run > 0 {
                let cell = |x: usize| CellIndex { x: grid.low().x + x as i32, y: grid.low().y + y };
                let (from, to) = (grid.centre(cell(x)), grid.centre(cell(x + run - 1)));
                let corner = |x: f64, side: f64| Point3::new(x, from.y + side * half, floor_z);
                let (left, right) = (from.x - half, to.x + half);
                let corners = [
                    corner(left, -1.0),
                    corner(right, -1.0),
                    corner(right, 1.0),
                    corner(left, 1.0),
                ];
                scene.polygon(&corners, GROUND);
            }
            x += run.max(1);
        }
    }
    let size = Vector3::new(grid.cell_m(), grid.cell_m(), top_z - floor_z);
    for (cell, _) in grid.iter().filter(|(_, what)| what.class == CellClass::Occupied) {
        let c = grid.centre(cell);
        let pose = Isometry3::translation(c.x, c.y, 0.5 * (floor_z + top_z));
        scene.block(&pose, &size, OBSTACLE);
    }
}

/// Drop-offs at the height of the ground beside them: as the squares that they are, and as dots that
/// are seen where a cell is no larger than a pixel.
fn add_edges(scene: &mut Scene, grid: &Grid) {
    let half = 0.5 * grid.cell_m();
    for (cell, what) in grid.iter().filter(|(_, what)| what.class == CellClass::DropOff) {
        let own = what.height_m.is_finite().then(|| f64::from(what.height_m));
        let Some(z) = height_beside(grid, cell).or(own) else { continue };
        let c = grid.centre(cell);
        let corner = |sx: f64, sy: f64| Point3::new(c.x + sx * half, c.y + sy * half, z + 0.02);
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        scene.polygon(&corners, EDGE);
        scene.point(Point3::new(c.x, c.y, z + 0.03), 2.5, EDGE);
    }
}

/// Height of the nearest drivable ground along a row or column.
fn height_beside(grid: &Grid, cell: CellIndex) -> Option<f64> {
    (1..=BESIDE_CELLS).find_map(|away| {
        [(away, 0), (-away, 0), (0, away), (0, -away)].iter().find_map(|(dx, dy)| {
            let next = grid.get(CellIndex { x: cell.x + dx, y: cell.y + dy });
            let is_ground = next.class.is_drivable() && next.height_m.is_finite();
            is_ground.then(|| f64::from(next.height_m))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::GridCell;

    /// Share of the picture's pixels that are of about a colour's hue.
    fn share(picture: &Canvas, is: impl Fn(Colour) -> bool) -> f64 {
        let (width, height) = (picture.width(), picture.height());
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let count = pixels.filter(|(x, y)| picture.pixel(*x, *y).is_some_and(&is)).count();
        count as f64 / (width * height) as f64
    }

    fn is_orange(c: Colour) -> bool {
        c.red > 100 && c.blue < c.red / 4 && c.green > c.red / 3
    }

    #[test]
    fn a_robot_that_stood_shows_the_walls_of_its_grid_and_not_only_itself() {
        // A ring of occupied cells 3 m about the robot, free within.
        let half = 60_i32;
        let cells = (-half..half).flat_map(|y| (-half..half).map(move |x| (x, y)));
        let cells: Vec<GridCell> = cells
            .map(|(x, y)| {
                let at_rim = x.abs().max(y.abs()) >= half - 1;
                let class = if at_rim { CellClass::Occupied } else { CellClass::FlatFree };
                GridCell { class, ..GridCell::default() }
            })
            .collect();
        let grid = Grid::from_cells(0.05, CellIndex { x: -half, y: -half }, 120, cells);
        let path = [Isometry3::identity(), Isometry3::translation(0.12, 0.0, 0.0)];
        let picture = draw(&[], &[], &grid, &path, &Vector3::new(0.5, 0.5, 0.6));
        let (robot, walls) = (
            share(&picture, is_orange),
            share(&picture, |c| c.blue > c.green && c.blue > c.red && c.blue < 230),
        );
        assert!((0.002..0.1).contains(&robot), "{robot}");
        assert!(walls > 0.05, "{walls}");
    }

    #[test]
    fn a_long_map_fills_the_width_and_no_more_rows_than_it_needs() {
        let points: Vec<Point3<f64>> = (0..400)
            .map(|i| Point3::new(f64::from(i % 40), f64::from(i / 40), f64::from(i % 3)))
            .collect();
        for turned in [false, true] {
            let points: Vec<Point3<f64>> = points
                .iter()
                .map(|p| if turned { Point3::new(p.y, p.x, p.z) } else { *p })
                .collect();
            let (camera, rows) = framed(&points);
            let [left, right, top, bottom] = extent_px(&camera, &points).unwrap();
            assert!(left >= 0.0 && right <= WIDTH as f64 && right - left > 0.9 * WIDTH as f64);
            assert!(top >= rows.start as f64 && bottom <= rows.end as f64);
            assert!(rows.len() < HEIGHT * 3 / 4, "{rows:?}");
        }
    }

    #[test]
    fn nothing_at_all_is_still_a_picture() {
        let grid = Grid::from_cells(0.05, CellIndex { x: 0, y: 0 }, 1, vec![GridCell::default()]);
        let picture = draw(&[], &[], &grid, &[], &Vector3::new(0.5, 0.5, 0.6));
        assert!(picture.height() > 50);
    }
}
