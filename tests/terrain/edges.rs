//! Drop-offs, steps, slopes and overhangs: what the grid must call drivable and what not.

use super::world::{Laser, Solid, World, coarse_tilts, paper_tilts, pose, tilted_pose};
use nalgebra::Isometry3;
use usar_agent::terrain::{CellClass, CellIndex, Grid, RobotShape, Terrain, TerrainConfig};

fn terrain() -> Terrain {
    Terrain::new(TerrainConfig::default(), RobotShape::default())
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
    let low = grid.low();
    let high = (low.x + grid.width() as i32, low.y + grid.height() as i32);
    draw_cells(grid, (low.x, low.y), high)
}

/// Prints the cells within `reach` of a point, the point itself as `R`.
pub fn draw_around(grid: &Grid, x: f64, y: f64, reach: f64) -> String {
    let (low, high) = (grid.cell_of(x - reach, y - reach), grid.cell_of(x + reach, y + reach));
    let mut text = draw_cells(grid, (low.x, low.y), (high.x, high.y));
    let at = grid.cell_of(x, y);
    let place = (high.y - 1 - at.y) * (high.x - low.x + 1) + at.x - low.x;
    text.replace_range(place as usize..=place as usize, "R");
    text
}

fn draw_cells(grid: &Grid, low: (i32, i32), high: (i32, i32)) -> String {
    let mut text = String::new();
    for y in (low.1..high.1).rev() {
        for x in low.0..high.0 {
            let cell = grid.get(CellIndex { x, y });
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

/// The grid after a sweep from each pose, the last of which it is projected from.
fn swept(world: &World, poses: &[Isometry3<f64>], tilts: &[f64], sigma: f64) -> Grid {
    let mut terrain = terrain();
    let mut laser = Laser::noisy(sigma, 7);
    terrain.assume(&poses[0], 1.3);
    for at in poses {
        let image = laser.sweep(world, at, &[0.0], tilts);
        terrain.integrate(&image, at);
        terrain.drive_over(at);
    }
    terrain.project(&poses[poses.len() - 1])
}

/// Poses from (0, 0) straight ahead along x, a step apart.
fn ahead(steps: &[f64]) -> Vec<Isometry3<f64>> {
    steps.iter().map(|&x| pose(x, 0.0, 0.0, 0.0)).collect()
}

fn share(grid: &Grid, x: (f64, f64), y: (f64, f64), is: impl Fn(CellClass) -> bool) -> f64 {
    let within = |cx: f64, cy: f64| cx > x.0 && cx < x.1 && cy > y.0 && cy < y.1;
    let all = count(grid, |cx, cy, _| within(cx, cy));
    let good = count(grid, |cx, cy, class| within(cx, cy) && is(class));
    good as f64 / all.max(1) as f64
}

/// Share of the lines along x, a cell apart, that meet an edge cell close to where the edge is.
fn marked(grid: &Grid, edge: f64) -> f64 {
    let lines: Vec<f64> = (-20..20).map(|line| 0.025 + 0.05 * f64::from(line)).collect();
    let meets =
        |y: f64| (-2..6).any(|step| grid.class_at(edge + 0.05 * f64::from(step), y).is_edge());
    lines.iter().filter(|&&y| meets(y)).count() as f64 / lines.len() as f64
}

fn floor() -> World {
    World::default().with(Solid::block([-20.0, -20.0, -2.0], [20.0, 20.0, 0.0]))
}

#[test]
fn level_floor_is_free_with_noise_from_none_to_thirty_millimetres() {
    for sigma in [0.0, 0.01, 0.03] {
        // Rings closer together than `sure_gap_m`, as the agent's own fans are.
        for tilts in [coarse_tilts(29.75, 0.3), paper_tilts()] {
            let grid = swept(&floor(), &ahead(&[0.0]), &tilts, sigma);
            let free = share(&grid, (1.3, 6.0), (-2.0, 2.0), CellClass::is_drivable);
            assert!(free > 0.97, "noise {sigma} m: {free}\n{}", draw(&grid.coarse(2)));
            let false_alarms = count(&grid, |_, _, class| class.is_edge());
            assert_eq!(false_alarms, 0, "noise {sigma} m:\n{}", draw(&grid.coarse(2)));
        }
    }
}

#[test]
fn a_platform_edge_is_called_a_drop_off_from_nearby() {
    for edge in [1.2, 1.6, 2.5] {
        let grid = swept(&platform(edge), &ahead(&[0.0]), &coarse_tilts(29.75, 0.5), 0.01);
        let called = marked(&grid, edge);
        assert!(called > 0.95, "edge at {edge}: {called}\n{}", draw(&grid.coarse(2)));
    }
}

#[test]
fn a_pit_without_any_return_is_an_edge() {
    let world = World::default().with(Solid::block([-10.0, -10.0, -2.0], [2.0, 10.0, 0.0]));
    let grid = swept(&world, &ahead(&[0.0]), &coarse_tilts(29.75, 0.5), 0.0);
    let called = marked(&grid, 2.0);
    assert!(called > 0.95, "{called}\n{}", draw(&grid.coarse(2)));
}

#[test]
fn ramps_up_and_down_become_free_ground_on_approach() {
    for (rise, length) in [(0.5, 2.5), (1.0, 2.75), (-0.5, 2.5), (-1.0, 2.75)] {
        let world = World::default()
            .with(Solid::block([-10.0, -5.0, -3.0], [2.0, 5.0, 0.0]))
            .with(Solid::ramp([2.0, -1.0], [2.0 + length, 1.0], 0.0, rise))
            .with(Solid::block([2.0 + length, -5.0, -3.0], [9.0, 5.0, rise]));
        // The last pose stands before the ramp, near enough to look down it.
        let grid = swept(&world, &ahead(&[0.0, 0.8, 1.5]), &paper_tilts(), 0.005);
        let free = share(&grid, (1.9, 1.6 + length), (-0.7, 0.7), CellClass::is_drivable);
        assert!(free > 0.8, "rise {rise} over {length}: {free}\n{}", draw(&grid.coarse(2)));
        let beside = share(&grid, (2.2, 1.9 + length), (1.1, 1.5), CellClass::is_drivable);
        assert!(
            beside < 0.05 || rise > 0.0,
            "beside the ramp: {beside}\n{}",
            draw(&grid.coarse(2))
        );
    }
}

#[test]
fn stairs_are_drivable_neither_up_nor_down() {
    for sign in [1.0, -1.0] {
        let mut world = World::default().with(Solid::block([-10.0, -5.0, -6.0], [2.0, 5.0, 0.0]));
        for step in 0..8 {
            let (x, z) = (2.0 + 0.29 * f64::from(step), sign * 0.17 * f64::from(step + 1));
            world = world.with(Solid::block([x, -5.0, -6.0], [x + 0.29, 5.0, z]));
        }
        world = world.with(Solid::block([4.32, -5.0, -6.0], [9.0, 5.0, sign * 1.36]));
        for tilts in [coarse_tilts(29.75, 0.4), paper_tilts()] {
            let grid = swept(&world, &ahead(&[0.0, 0.7, 1.2]), &tilts, 0.005);
            let beyond = count(&grid, |x, y, class| {
                x > 2.1
                    && y.abs() < 4.0
                    && class.is_drivable()
                    && grid.class_at(x, y).is_drivable()
                    && grid.get(grid.cell_of(x, y)).reachable
            });
            assert_eq!(beyond, 0, "sign {sign}\n{}", draw(&grid.coarse(2)));
        }
    }
}

#[test]
fn kerbs_higher_than_the_robot_climbs_stop_it_and_lower_ones_do_not() {
    for (height, passable) in [(0.05, true), (0.10, false), (0.15, false), (-0.10, false)] {
        let world = World::default()
            .with(Solid::block([-10.0, -5.0, -3.0], [2.5, 5.0, 0.0]))
            .with(Solid::block([2.5, -5.0, -3.0], [10.0, 5.0, height]));
        for tilts in [coarse_tilts(29.75, 0.4), paper_tilts()] {
            let grid = swept(&world, &ahead(&[0.0, 0.5, 1.0]), &tilts, 0.004);
            let reached = count(&grid, |x, y, _| {
                x > 3.2 && y.abs() < 1.0 && grid.get(grid.cell_of(x, y)).reachable
            });
            assert_eq!(reached > 0, passable, "kerb of {height} m\n{}", draw(&grid.coarse(2)));
        }
    }
}

#[test]
fn a_thin_pole_is_an_obstacle_and_stays_one() {
    let world = floor().with(Solid::pole(2.5, 0.1, 0.03, 2.0));
    // Seen from several places: rays that pass beside the pole must not erase it.
    let mut poses = ahead(&[0.0, 0.5, 1.0]);
    poses.extend([pose(1.0, 1.5, 0.0, -0.7), pose(1.0, -1.2, 0.0, 0.6)]);
    let grid = swept(&world, &poses, &coarse_tilts(29.75, 0.5), 0.01);
    let hit =
        count(&grid, |x, y, class| (x - 2.5).hypot(y - 0.1) < 0.08 && class == CellClass::Occupied);
    assert!(hit > 0, "{}", draw(&grid.coarse(2)));
}

#[test]
fn a_table_lower_than_the_robot_is_an_obstacle_though_the_floor_below_is_seen() {
    for height in [0.45, 0.68] {
        let world = floor().with(Solid::block([2.5, -0.6, height - 0.03], [3.3, 0.6, height]));
        let grid = swept(&world, &ahead(&[0.0, 0.6, 1.2]), &coarse_tilts(29.75, 0.4), 0.005);
        let driven = count(&grid, |x, y, _| {
            (2.55..3.25).contains(&x) && y.abs() < 0.5 && grid.get(grid.cell_of(x, y)).reachable
        });
        assert_eq!(driven, 0, "table of {height} m\n{}", draw(&grid.coarse(2)));
    }
    // A lintel well above the robot does not close the way.
    let world = floor().with(Solid::block([2.5, -5.0, 1.0], [2.7, 5.0, 2.0]));
    let grid = swept(&world, &ahead(&[0.0, 0.8]), &coarse_tilts(29.75, 0.4), 0.005);
    let beyond = share(&grid, (2.9, 4.0), (-1.0, 1.0), CellClass::is_drivable);
    assert!(beyond > 0.9, "{beyond}\n{}", draw(&grid.coarse(2)));
}

#[test]
fn a_rail_is_not_driven_over() {
    let world = floor().with(Solid::block([2.5, -20.0, 0.0], [2.57, 20.0, 0.15]));
    for tilts in [coarse_tilts(29.75, 0.4), paper_tilts()] {
        let grid = swept(&world, &ahead(&[0.0, 0.5, 1.0]), &tilts, 0.005);
        let reached = count(&grid, |x, y, _| {
            x > 2.6 && y.abs() < 1.5 && grid.get(grid.cell_of(x, y)).reachable
        });
        assert_eq!(reached, 0, "{}", draw(&grid.coarse(2)));
    }
}

#[test]
fn floor_that_does_not_answer_is_never_free() {
    let world = floor().with_mute(Solid::block([2.0, -1.0, -0.5], [4.0, 1.0, 0.01]));
    for tilts in [coarse_tilts(29.75, 0.5), paper_tilts()] {
        let grid = swept(&world, &ahead(&[0.0, 0.5]), &tilts, 0.0);
        let free =
            count(&grid, |x, y, class| x > 2.1 && x < 3.9 && y.abs() < 0.9 && class.is_drivable());
        assert_eq!(free, 0, "{}", draw(&grid.coarse(2)));
    }
}

#[test]
fn a_robot_tilted_on_a_ramp_sees_the_ramp_as_ground_and_its_edges_as_edges() {
    // A ramp of 15°, two metres wide, high above what lies beside it.
    let slope = 15_f64.to_radians();
    let world = World::default()
        .with(Solid::ramp([-5.0, -1.0], [5.0, 1.0], -5.0 * slope.tan(), 5.0 * slope.tan()))
        .with(Solid::block([-20.0, -20.0, -6.0], [20.0, 20.0, -4.0]));
    let at = tilted_pose(0.0, 0.0, 0.0, 0.0, -slope, 0.0);
    let grid = swept(&world, &[at], &coarse_tilts(29.75, 0.4), 0.003);
    let free = share(&grid, (1.3, 3.5), (-0.8, 0.8), CellClass::is_drivable);
    assert!(free > 0.9, "{free}\n{}", draw(&grid.coarse(2)));
    let off = count(&grid, |_, y, class| y.abs() > 1.1 && class.is_drivable());
    // The assumed disc is the only thing that reaches beyond.
    let assumed = count(&grid, |_, y, class| y.abs() > 1.1 && class == CellClass::Assumed);
    assert_eq!(off, assumed, "{}", draw(&grid.coarse(2)));
}

#[test]
fn a_door_of_eighty_centimetres_is_open_to_the_robot() {
    let world = floor()
        .with(Solid::block([2.5, -5.0, 0.0], [2.65, -0.4, 2.0]))
        .with(Solid::block([2.5, 0.4, 0.0], [2.65, 5.0, 2.0]));
    for yaw in [0.0, 0.4] {
        let poses = [0.0, 0.7].map(|x| pose(x, -0.3 * yaw, 0.0, yaw));
        let beyond = |ring_m: f64| {
            let grid = swept(&world, &poses, &coarse_tilts(29.75, ring_m), 0.01);
            count(&grid, |x, y, _| {
                x > 3.2 && y.abs() < 0.5 && grid.get(grid.cell_of(x, y)).reachable
            })
        };
        assert!(beyond(0.3) > 0, "turned by {yaw}");
        // Rings that a hole could hide between open nothing.
        assert_eq!(beyond(0.5), 0, "turned by {yaw}");
    }
}

#[test]
fn a_world_turned_by_any_angle_is_judged_the_same() {
    for degrees in [17, 45, 130] {
        let yaw = f64::from(degrees).to_radians();
        let world = World::default()
            .with(Solid::block([-10.0, -10.0, -2.0], [2.0, 10.0, 0.0]).turned(yaw, [0.0, 0.0]))
            .with(Solid::block([-20.0, -20.0, -3.0], [20.0, 20.0, -1.0]));
        let grid = swept(&world, &[pose(0.0, 0.0, 0.0, yaw)], &coarse_tilts(29.75, 0.5), 0.005);
        let (sin, cos) = yaw.sin_cos();
        let beyond = count(&grid, |x, y, class| cos * x + sin * y > 2.05 && class.is_drivable());
        assert_eq!(beyond, 0, "turned by {degrees}°\n{}", draw(&grid.coarse(2)));
        let called = count(&grid, |x, y, class| {
            let (u, v) = (cos * x + sin * y, cos * y - sin * x);
            (2.0..2.3).contains(&u) && v.abs() < 1.0 && class.is_edge()
        });
        assert!(called > 100, "{called}\n{}", draw(&grid.coarse(2)));
    }
}

/// A platform that ends at x = 2 m, a slit of the given width, and behind it a block whose top lies
/// `rise` above the platform; all of it turned by `yaw` about a place on the platform.
fn slit(width: f64, rise: f64, yaw: f64) -> World {
    World::default()
        .with(Solid::block([-10.0, -12.0, -3.0], [2.0, 12.0, 0.0]).turned(yaw, SLIT_CENTRE))
        .with(Solid::block([2.0 + width, -1.5, -3.0], [2.6, 1.5, rise]).turned(yaw, SLIT_CENTRE))
        .with(Solid::block([2.0, -12.0, -3.0], [9.0, 12.0, -1.0]).turned(yaw, SLIT_CENTRE))
}

const SLIT_CENTRE: [f64; 2] = [1.6, 0.0];

#[test]
fn a_slit_that_takes_a_wheel_is_not_driven_into_whatever_was_seen_from_afar() {
    for rise in [0.05, 0.02, 0.0] {
        for width in [0.10, 0.12, 0.15, 0.20] {
            for yaw in [0.0_f64, 0.3, 0.7] {
                let world = slit(width, rise, yaw);
                let grid = swept(&world, &ahead(&[-1.5, 0.0, 0.6, 1.0]), &paper_tilts(), 0.01);
                let (sin, cos) = yaw.sin_cos();
                let entered = count(&grid, |x, y, _| {
                    let (dx, dy) = (x - SLIT_CENTRE[0], y - SLIT_CENTRE[1]);
                    let (u, v) = (dx * cos + dy * sin, dy * cos - dx * sin);
                    // Where the robot's middle may be, its wheels may be 0.25 m farther.
                    (0.2..0.4 + width).contains(&u)
                        && v.abs() < 1.0
                        && grid.get(grid.cell_of(x, y)).reachable
                });
                assert_eq!(
                    entered,
                    0,
                    "{width} m, {rise} m up, {yaw} rad\n{}",
                    draw_around(&grid, 1.2, 0.0, 1.9)
                );
            }
        }
    }
}
