//! Drop-offs, steps, slopes and overhangs: what the grid must call drivable and what not.

use super::world::{Laser, Solid, World, coarse_tilts, paper_tilts, pose, tilted_pose};
use nalgebra::Isometry3;
use usar_agent::scan::RangeImage;
use usar_agent::terrain::{CellClass, Grid, RobotShape, Terrain, TerrainConfig};

fn terrain() -> Terrain {
    Terrain::new(TerrainConfig::default(), RobotShape::default())
}

fn seen(images: &[(RangeImage, Isometry3<f64>)]) -> (Terrain, Grid) {
    let mut terrain = terrain();
    terrain.assume(&images[0].1, 1.2);
    for (image, world_from_robot) in images {
        terrain.integrate(image, world_from_robot);
    }
    let grid = terrain.project(&images[images.len() - 1].1);
    (terrain, grid)
}

fn count(grid: &Grid, mut within: impl FnMut(f64, f64, CellClass) -> bool) -> usize {
    grid.iter()
        .filter(|(cell, value)| {
            let centre = grid.centre(*cell);
            within(centre.x, centre.y, value.class)
        })
        .count()
}

/// Prints the grid as text: for looking at a failure.
pub fn draw(grid: &Grid) -> String {
    let mut text = String::new();
    for y in (0..grid.height()).rev() {
        for x in 0..grid.width() {
            let cell = grid.cells()[y * grid.width() + x];
            text.push(match cell.class {
                CellClass::Unknown => ' ',
                CellClass::Free if cell.reachable => '.',
                CellClass::Free => ',',
                CellClass::Assumed => 'a',
                CellClass::Occupied => '#',
                CellClass::TooSteep => '/',
                CellClass::DropOff => 'D',
                CellClass::Suspect => '?',
                CellClass::OtherLevel => 'o',
                CellClass::FlatFree => '_',
            });
        }
        text.push('\n');
    }
    text
}

fn platform(edge: f64) -> World {
    World::default()
        .with(Solid::block([-10.0, -10.0, -2.0], [edge, 10.0, 0.0]))
        .with(Solid::block([-20.0, -20.0, -3.0], [30.0, 20.0, -1.0]))
}

#[test]
fn no_ground_is_seen_beyond_a_platform_edge_from_any_distance_and_angle() {
    for edge in [0.5, 0.8, 1.0, 1.3, 2.0, 3.0, 4.5, 6.0] {
        for degrees in [0, 20, 45, 70, 90, 135, 180] {
            let yaw = f64::from(degrees).to_radians();
            for (tilts, name) in [(coarse_tilts(29.75, 0.5), "coarse"), (paper_tilts(), "paper")] {
                let at = pose(0.0, 0.0, 0.0, yaw);
                let image = Laser::exact().sweep(&platform(edge), &at, &[0.0], &tilts);
                let mut terrain = terrain();
                terrain.assume(&at, 0.45);
                terrain.integrate(&image, &at);
                let grid = terrain.project(&at);
                let beyond = count(&grid, |x, _, class| x > edge + 0.05 && class.is_drivable());
                assert_eq!(
                    beyond,
                    0,
                    "{name} sweep, edge at {edge} m, heading {degrees}°:\n{}",
                    draw(&grid)
                );
            }
        }
    }
}

#[test]
fn debug_draw() {
    let at = pose(0.0, 0.0, 0.0, 0.0);
    for edge in [1.5, 3.0] {
        let image = Laser::exact().sweep(&platform(edge), &at, &[0.0], &coarse_tilts(29.75, 0.5));
        let (_, grid) = seen(&[(image, at)]);
        println!("{}", draw(&grid.coarse(2)));
    }
    let _ = tilted_pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
}
