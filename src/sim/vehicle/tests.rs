use super::*;
use crate::protocol::Dialect;
use crate::sim::catalogue::RobotCatalogue;
use crate::sim::map_file::MapFile;
use crate::sim::world::placed;
use std::collections::BTreeMap;

const FLOOR: &str =
    "[[box]]\nname = \"floor\"\ncenter = [0.0, 0.0, -0.5]\nsize = [80.0, 80.0, 1.0]\n";

struct Bench {
    world: World,
    physics: Physics,
    robot: Box<dyn Vehicle>,
    class: RobotClass,
}

impl Bench {
    /// A robot at rest on the origin's ground, `drop_m` above it, in a world of the given shapes.
    fn new(class: &str, motion: Motion, shapes: &str) -> Self {
        let map = format!("name = \"m\"\nbounds = [-9.0, -9.0, 9.0, 9.0]\n{shapes}");
        let world = World::new(&MapFile::parse(&map).unwrap(), &BTreeMap::new()).unwrap();
        let catalogue = RobotCatalogue::parse(include_str!("../../../maps/robots.toml")).unwrap();
        let class = catalogue.find(class, Dialect::Ut2004).unwrap().clone();
        let mut physics = Physics::new(&world);
        let pose = placed([0.0, 0.0, class.origin_height_m() + 0.005], [0.0; 3]);
        let robot = spawn(motion, &class, RobotKey(1), &mut physics, &pose);
        let mut bench = Self { world, physics, robot, class };
        bench.run(0.5);
        bench
    }

    fn paper_robot(shapes: &str) -> Self {
        Self::new("P3AT", Motion::Rigid, shapes)
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / crate::sim::physics::STEP_S).round() as usize {
            self.robot.before_step(&mut self.physics, &self.world);
            self.physics.step();
            self.robot.after_step(&self.physics);
        }
    }

    fn drive(&mut self, left_mps: f64, right_mps: f64, seconds: f64) {
        let radius = self.class.wheels.radius_m;
        self.robot.drive([left_mps / radius, right_mps / radius]);
        self.run(seconds);
    }

    fn position(&self) -> Vector3<f64> {
        self.robot.state().world_from_robot.translation.vector
    }

    /// Height of the ground under a robot that stands level.
    fn ground(&self) -> f64 {
        self.position().z - self.class.origin_height_m()
    }

    fn yaw(&self) -> f64 {
        let ahead = self.robot.state().world_from_robot.rotation * Vector3::x();
        ahead.y.atan2(ahead.x)
    }

    fn tilt_deg(&self) -> f64 {
        let up = self.robot.state().world_from_robot.rotation * Vector3::z();
        up.z.clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// Yaw rate over one second of a steady turn.
    fn turn_rate(&mut self, rim_mps: f64) -> f64 {
        self.drive(-rim_mps, rim_mps, 1.0);
        let before = self.yaw();
        self.run(1.0);
        crate::geometry::wrap_pi(self.yaw() - before)
    }
}

/// A ramp of the given slope that begins 1 m ahead and climbs 1.2 m.
fn ramp(slope_deg: f64) -> String {
    let length = 1.2 / slope_deg.to_radians().tan();
    format!(
        "{FLOOR}[[wedge]]\nname = \"ramp\"\ncenter = [{}, 0.0, 0.6]\nsize = [{length}, 3.0, 1.2]\n\
         [[box]]\nname = \"top\"\ncenter = [{}, 0.0, 0.6]\nsize = [4.0, 3.0, 1.2]\n",
        1.0 + length / 2.0,
        3.0 + length
    )
}

fn kerb(height_m: f64) -> String {
    format!(
        "{FLOOR}[[box]]\nname = \"kerb\"\ncenter = [4.0, 0.0, {}]\nsize = [6.0, 6.0, {height_m}]\n",
        height_m / 2.0
    )
}

#[test]
fn drives_straight_at_the_speed_of_its_wheels_and_stops() {
    for class in ["P3AT", "P2AT", "P2DX"] {
        let mut bench = Bench::new(class, Motion::Rigid, FLOOR);
        assert!(bench.ground().abs() < 0.003, "{class} stands at {}", bench.ground());
        bench.drive(0.5, 0.5, 2.0);
        let before = bench.position().x;
        bench.run(1.0);
        let speed = bench.position().x - before;
        assert!((speed - 0.5).abs() < 0.01, "{class}: {speed}");
        assert!(bench.yaw().abs() < 0.02 && bench.position().y.abs() < 0.02, "{class}");
        bench.drive(0.0, 0.0, 1.0);
        let stopped = bench.position();
        bench.run(2.0);
        assert!((bench.position() - stopped).norm() < 0.002, "{class}");
    }
}

/// In a recording of six seconds both wheels of a straight run agree to a tick of their encoders.
#[test]
fn wheels_of_a_straight_run_turn_alike() {
    let tick_rad = 1.0_f64.to_radians();
    for class in ["P3AT", "P2AT", "P2DX"] {
        let mut bench = Bench::new(class, Motion::Rigid, FLOOR);
        let radius = bench.class.wheels.radius_m;
        for rim_mps in [0.02, 0.4] {
            bench.drive(rim_mps, rim_mps, 1.0);
            let before = bench.robot.state().wheel_angles_rad.clone();
            bench.run(4.0);
            for (before, after) in before.iter().zip(&bench.robot.state().wheel_angles_rad) {
                let off_rad = after - before - 4.0 * rim_mps / radius;
                assert!(off_rad.abs() < tick_rad, "{class} at {rim_mps} m/s: {off_rad} rad off");
            }
        }
    }
}

#[test]
fn turns_in_place_slower_than_the_wheels_say() {
    let mut bench = Bench::paper_robot(FLOOR);
    let rate = bench.turn_rate(0.3);
    let wheels = &bench.class.wheels;
    let ideal = 2.0 * 0.3 / wheels.separation_m;
    let (track, base) = (wheels.separation_m.powi(2), wheels.base_m.powi(2));
    let expected = track / (track + base);
    let share = rate / ideal;
    assert!((share - expected).abs() < 0.12, "turned at {share} of the ideal, theory {expected}");
    assert!(bench.position().xy().norm() < 0.3, "{}", bench.position());
}

#[test]
fn two_wheels_and_a_caster_turn_without_skidding() {
    let mut bench = Bench::new("P2DX", Motion::Rigid, FLOOR);
    let rate = bench.turn_rate(0.2);
    let ideal = 2.0 * 0.2 / bench.class.wheels.separation_m;
    assert!((rate / ideal - 1.0).abs() < 0.1, "{}", rate / ideal);
}

#[test]
fn climbs_a_ramp_of_20_degrees_and_holds_on_it() {
    let mut bench = Bench::paper_robot(&ramp(20.0));
    bench.drive(0.4, 0.4, 5.0);
    bench.drive(0.0, 0.0, 1.0);
    let parked = bench.position();
    assert!((bench.tilt_deg() - 20.0).abs() < 1.0 && parked.z > 0.3);
    bench.run(5.0);
    assert!((bench.position() - parked).norm() < 0.01, "slid {}", bench.position() - parked);
    bench.drive(0.4, 0.4, 8.0);
    assert!((bench.ground() - 1.2).abs() < 0.02, "reached {}", bench.position());
}

#[test]
fn comes_down_a_ramp_of_20_degrees_without_toppling() {
    let mut bench = Bench::paper_robot(&ramp(20.0));
    bench.drive(0.6, 0.6, 9.0);
    assert!((bench.ground() - 1.2).abs() < 0.02);
    bench.drive(-0.7, -0.7, 3.0);
    bench.drive(0.0, 0.0, 1.0);
    assert!(bench.tilt_deg() < 22.0, "{}", bench.tilt_deg());
    bench.drive(-0.7, -0.7, 6.0);
    bench.drive(0.0, 0.0, 1.0);
    assert!(bench.ground().abs() < 0.01 && bench.tilt_deg() < 1.0);
}

#[test]
fn climbs_a_kerb_of_5_cm_at_any_speed() {
    for speed in [0.1, 0.3, 0.7] {
        let mut bench = Bench::paper_robot(&kerb(0.05));
        bench.drive(speed, speed, 2.0 / speed);
        bench.drive(0.0, 0.0, 1.0);
        assert!((bench.ground() - 0.05).abs() < 0.01, "at {speed}: {}", bench.position());
    }
}

#[test]
fn does_not_get_over_a_kerb_of_15_cm() {
    for speed in [0.2, 0.7] {
        let mut bench = Bench::paper_robot(&kerb(0.15));
        bench.drive(speed, speed, 8.0);
        assert!(bench.position().x < 1.1, "at {speed}: {}", bench.position());
    }
}

#[test]
fn falls_off_an_edge() {
    let platform = "[[box]]\nname = \"platform\"\ncenter = [0.0, 0.0, -0.5]\nsize = [3.0, 6.0, 1.0]\n\
                    [[box]]\nname = \"bed\"\ncenter = [0.0, 0.0, -1.5]\nsize = [30.0, 30.0, 1.0]\n";
    let mut bench = Bench::paper_robot(platform);
    bench.drive(0.5, 0.5, 5.0);
    assert!(bench.position().z < -0.5, "{}", bench.position());
}

#[test]
fn tips_over_backwards_on_a_slope_too_steep_for_it() {
    let mut bench = Bench::paper_robot(&ramp(45.0));
    bench.drive(0.7, 0.7, 5.0);
    let stands = bench.tilt_deg() < 1.0;
    bench.drive(0.0, 0.0, 2.0);
    assert!(!stands && bench.ground() < 0.6, "{} {}", bench.tilt_deg(), bench.position());
    let sideways = placed([0.0, 0.0, 0.5], [50.0, 0.0, 0.0]);
    let mut bench = Bench::paper_robot(FLOOR);
    let robot = &mut bench.robot;
    robot.place(&mut bench.physics, &sideways);
    bench.run(2.0);
    assert!(bench.tilt_deg() > 60.0, "{}", bench.tilt_deg());
}

#[test]
fn slips_so_that_odometry_drifts() {
    let mut bench = Bench::paper_robot(FLOOR);
    bench.drive(0.2, 0.4, 5.0);
    let angles = &bench.robot.state().wheel_angles_rad;
    let wheels = &bench.class.wheels;
    let by_wheels = (angles[1] - angles[0]) * wheels.radius_m / wheels.separation_m;
    assert!(by_wheels - bench.yaw() > 0.3, "wheels {by_wheels}, truth {}", bench.yaw());
}

#[test]
fn a_wall_stops_it_and_is_felt() {
    let wall = "[[box]]\nname = \"wall\"\ncenter = [1.5, 0.0, 0.5]\nsize = [0.2, 3.0, 1.0]\n";
    let mut bench = Bench::paper_robot(&format!("{FLOOR}{wall}"));
    bench.drive(0.3, 0.3, 5.0);
    assert!(bench.position().x < 1.4 - 0.24);
    let touches = &bench.robot.state().body_touches;
    assert!(!touches.is_empty(), "pressed against the wall");
    assert!(touches.iter().all(|touch| touch.push.x < -0.9 && touch.point.x > 0.9));
}

#[test]
fn ideal_motion_follows_the_wheels_exactly() {
    let mut bench = Bench::new("P3AT", Motion::Ideal, FLOOR);
    let rate = bench.turn_rate(0.2);
    assert!((rate - 1.0).abs() < 1e-6, "{rate}");
    bench.drive(0.0, 0.0, 1.0);
    let before = bench.position();
    bench.drive(0.5, 0.5, 3.0);
    bench.drive(0.0, 0.0, 1.0);
    assert!(((bench.position() - before).norm() - 1.5).abs() < 1e-6);
}

#[test]
fn ideal_motion_climbs_ramps_and_stops_at_walls_and_kerbs() {
    let mut bench = Bench::new("P3AT", Motion::Ideal, &ramp(20.0));
    bench.drive(0.5, 0.5, 4.0);
    assert!((bench.tilt_deg() - 20.0).abs() < 0.5, "{}", bench.tilt_deg());
    bench.drive(0.5, 0.5, 8.0);
    assert!((bench.ground() - 1.2).abs() < 0.01);
    let mut bench = Bench::new("P3AT", Motion::Ideal, &kerb(0.15));
    bench.drive(0.5, 0.5, 6.0);
    assert!(bench.position().x < 1.0);
}

#[test]
fn two_runs_give_the_same_bits() {
    let run = || {
        let mut bench = Bench::paper_robot(&kerb(0.05));
        bench.drive(0.3, 0.5, 2.0);
        bench.drive(-0.4, 0.4, 1.5);
        bench.drive(0.7, 0.6, 2.0);
        let state = bench.robot.state();
        let pose = state.world_from_robot;
        let mut bits: Vec<u64> = pose.translation.vector.iter().map(|x| x.to_bits()).collect();
        bits.extend(pose.rotation.coords.iter().map(|x| x.to_bits()));
        bits.extend(state.wheel_angles_rad.iter().map(|x| x.to_bits()));
        bits
    };
    assert_eq!(run(), run());
}

#[test]
fn a_robot_that_is_removed_leaves_nothing_behind() {
    let mut bench = Bench::paper_robot(FLOOR);
    bench.robot.remove(&mut bench.physics);
    assert_eq!(bench.physics.bodies.bodies.len(), 0);
    assert_eq!(bench.physics.bodies.impulse_joints.len(), 0);
    assert_eq!(bench.physics.bodies.colliders.len(), 1);
}
