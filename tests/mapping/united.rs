//! Surfaces that are mapped in pieces and turn out to be one, and some that are two.

use super::slips::{Seen, along};
use crate::segmentation::world::World;
use nalgebra::Isometry3;
use usar_agent::mapping::perturbation::pose_error;
use usar_agent::mapping::{LandmarkId, Mapper, MapperConfig, MotionSource};

/// The map of what is seen along a way by a robot whose wheels are right, and what was united on it.
fn mapped(seen: &[Seen]) -> (Mapper, Vec<(LandmarkId, LandmarkId)>) {
    let mut mapper = Mapper::new(MapperConfig::default(), seen[0].1);
    let mut united = mapper.observe(&seen[0].0).merged;
    for pair in seen.windows(2) {
        mapper.predict(&(pair[0].1.inverse() * pair[1].1), MotionSource::Wheels);
        united.extend(mapper.observe(&pair[1].0).merged);
    }
    (mapper, united)
}

/// Where along x the landmarks lie that face the robot from ahead.
fn walls_ahead(mapper: &Mapper) -> Vec<f64> {
    let ahead = mapper.landmarks().iter().filter(|it| it.normal().x < -0.99 && it.area_m2() > 0.3);
    ahead.map(|it| it.origin().x).collect()
}

/// A room with a cupboard before its far wall.
fn with_cupboard() -> World {
    let mut world = World::default();
    world.room([-3.0, -3.0, 5.0, 3.0], 2.8);
    world.standing(2.6, 0.0, [0.5, 1.2, 2.2], 0.0);
    world.standing(0.6, 2.4, [0.7, 0.4, 0.9], 0.3);
    world
}

/// Past the cupboard on its right until the whole wall is in sight.
const PAST: [(f64, f64, f64); 8] = [
    (-1.8, 0.0, 0.0),
    (-1.3, -0.2, -4.0),
    (-0.8, -0.6, -6.0),
    (-0.3, -1.1, 0.0),
    (0.3, -1.5, 8.0),
    (1.0, -1.7, 15.0),
    (1.9, -1.8, 25.0),
    (2.6, -1.8, 40.0),
];

#[test]
fn the_pieces_of_a_wall_to_both_sides_of_a_cupboard_become_one() {
    let seen = along(&with_cupboard(), &PAST);
    let (first, _) = mapped(&seen[..1]);
    let pieces = walls_ahead(&first).iter().filter(|x| (*x - 5.0).abs() < 0.02).count();
    assert_eq!(pieces, 2, "the cupboard hides the middle of the wall");

    let (mapper, united) = mapped(&seen);
    let walls: Vec<f64> =
        walls_ahead(&mapper).into_iter().filter(|x| (x - 5.0).abs() < 0.1).collect();
    assert_eq!(walls.len(), 1, "{walls:?}");
    assert!((walls[0] - 5.0).abs() < 0.003, "{walls:?}");
    assert!(!united.is_empty());
    for (kept, gone) in united {
        assert!(kept < gone);
        assert!(mapper.landmarks().iter().all(|it| it.id != gone), "{gone:?} is still there");
        let seen_in = (0..seen.len()).flat_map(|keyframe| mapper.sightings(keyframe));
        assert!(seen_in.into_iter().all(|(landmark, _)| landmark != gone));
    }
    // All that was known of the pieces is known of the whole: cells, extent, covariance, poses.
    let wall = mapper.landmarks().iter().find(|it| {
        it.normal().x < -0.99 && (it.origin().x - 5.0).abs() < 0.1 && it.area_m2() > 0.3
    });
    let wall = wall.expect("the wall is there");
    assert!(wall.area_m2() > 13.0, "{} m²", wall.area_m2());
    assert_eq!(wall.first_keyframe, 0);
    let covariance = mapper.landmark_covariance(wall.id).expect("it is known");
    assert!(covariance.symmetric_eigenvalues().min() > 0.0, "{covariance}");
    for (keyframe, (_, truth)) in mapper.keyframes().iter().zip(&seen) {
        let off = pose_error(keyframe, truth);
        assert!(off.fixed_rows::<3>(0).norm() < 0.003, "{off}");
    }
}

/// From afar panel and wall are one surface, of which the panel is a part; from near they are two, and the
/// surface that was seen from afar is one of them or between.
#[test]
fn a_panel_does_not_unite_with_the_wall_that_it_hangs_on() {
    for thick_m in [0.015, 0.03] {
        let mut world = World::default();
        world.room([-7.0, -3.0, 5.0, 3.0], 2.8);
        let panel = Isometry3::translation(5.0 - 0.5 * thick_m, 0.0, 1.2);
        world.block(&panel, [thick_m, 1.6, 1.4]);
        world.standing(1.6, 2.4, [0.7, 0.4, 0.9], 0.3);
        let way: Vec<(f64, f64, f64)> =
            (0..14).map(|k| (-6.0 + 0.7 * f64::from(k), 0.1, f64::from(k % 3) - 1.0)).collect();
        let (mapper, _) = mapped(&along(&world, &way));
        let ahead = walls_ahead(&mapper);
        let at = |x: f64| ahead.iter().any(|it| (it - x).abs() < 0.003);
        assert!(at(5.0) && at(5.0 - thick_m), "{thick_m} m: {ahead:?}");
    }
}
