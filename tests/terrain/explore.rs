//! Exploration of whole worlds.

use super::closed_loop::{Robot, start_pose};
use super::edges::draw;
use super::world::{Laser, Solid, World, coarse_tilts};

fn room() -> World {
    World::default()
        .with(Solid::block([-12.0, -12.0, -2.0], [12.0, 12.0, 0.0]))
        .with(Solid::block([-5.2, -4.2, 0.0], [-5.0, 4.2, 2.5]))
        .with(Solid::block([5.0, -4.2, 0.0], [5.2, 4.2, 2.5]))
        .with(Solid::block([-5.2, -4.2, 0.0], [5.2, -4.0, 2.5]))
        .with(Solid::block([-5.2, 4.0, 0.0], [5.2, 4.2, 2.5]))
        .with(Solid::block([-1.0, -4.0, 0.0], [-0.8, 1.5, 2.5]))
        .with(Solid::block([-1.0, 2.4, 0.0], [-0.8, 4.0, 2.5]))
        .with(Solid::block([2.0, -2.0, 0.0], [3.0, -1.0, 0.4]))
}

#[test]
fn a_room_is_explored_to_the_end() {
    let mut robot = Robot::new(
        room(),
        start_pose(-3.0, -2.0, 0.3),
        vec![-1.57, 0.0, 1.57, 3.1],
        coarse_tilts(29.75, 0.5),
        Laser::exact(),
    );
    robot.start(1.3);
    let mut rounds = 0;
    while rounds < 40 && robot.explore_once() {
        rounds += 1;
    }
    assert!(robot.violations.is_empty(), "{:#?}", robot.violations);
    let seen = |x: f64, y: f64| robot.grid.class_at(x, y).is_drivable();
    assert!(
        seen(-4.5, -3.5) && seen(4.5, 3.5) && seen(4.5, -3.5) && seen(0.0, 0.0),
        "after {} sweeps: {:#?}\n{}",
        robot.sweeps,
        robot.events,
        draw(&robot.grid.coarse(2))
    );
    assert!(rounds < 40, "ends by itself");
}
