//! The range that beams carry which hit nothing.
//!
//! UDK's scanners measure to the point that was hit, and where nothing is they leave that point where the
//! engine left it, at the level's origin (protocol 3.5): the beam carries the distance from there to the
//! sensor. Many of them in one line give themselves away; a few look like a thing in the way, or like
//! ground. But from one place they all carry the same range, and it changes with the place as the distance
//! to the origin does, so that what one line shows tells of the lines about it.

use crate::scan::{LaserLine, RangeImage, Return};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What was seen of that range, and from where.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhantomWatch {
    /// The newest last.
    sightings: VecDeque<Sighting>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Sighting {
    /// Where the sensor was, in the map frame.
    place: Point3<f64>,
    range_m: f64,
}

/// Places kept: more than there are rows in a sweep.
const KEPT: usize = 256;
/// Places nearer to each other than this, in metres, are one.
const SAME_PLACE_M: f64 = 0.005;
/// What a range that was cut to hundredths of a metre is off by, and a part of another one.
const CUT_M: f64 = 0.015;
/// The map's origin is the level's if a sighting agrees with that to this, in metres.
const LEVEL_WITHIN_M: f64 = 0.5;
/// Share of a way by which the distance to the level's origin is off after it: dead reckoning.
const DRIFT: f64 = 0.05;
/// A range that may be off by more than this, in metres, would take too much with it that is there.
const MOST_OFF_M: f64 = 0.06;
/// A beam that falls by less than this a metre meets no ground that could end before it.
const LEVEL: f64 = 0.03;
/// Neighbours on one surface differ by less than this share of their range.
const SAME_SURFACE: f64 = 0.05;
/// Beams like their neighbours in all rows of a scan that make such a range, and how many times as many as
/// of any range about it they are: a surface seen square across a single line makes two and a half times
/// as many.
const FEWEST: usize = 8;
const STANDS_OUT: usize = 4;

impl PhantomWatch {
    /// Takes note of what `line` shows of it, cast with the sensor at `world_from_sensor`, and gives the line
    /// without the beams that hit nothing for all that is known.
    pub fn without(&mut self, line: &LaserLine, world_from_sensor: &Isometry3<f64>) -> LaserLine {
        let place = Point3::from(world_from_sensor.translation.vector);
        if let Some(range_m) = line.phantom_m {
            self.note(Sighting { place, range_m });
            return line.clone();
        }
        let mut line = line.clone();
        let Some(phantom) = self.at(&place) else { return line };
        let seen: Vec<Return> = (0..line.len()).map(|beam| line.classify(beam)).collect();
        let falls = |beam: usize| -(world_from_sensor.rotation * line.direction(beam)).z;
        let missing = phantom.among(&seen, falls);
        missing.into_iter().for_each(|beam| line.ranges_m[beam] = f64::NAN);
        line
    }

    /// The same for a scan all of whose rows are there, those before the first that showed anything included.
    /// Gives how many beams hit nothing.
    pub fn take_from(
        &mut self,
        image: &mut RangeImage,
        world_from_robot: &Isometry3<f64>,
    ) -> usize {
        let world_from_scan = world_from_robot * image.robot_from_scan;
        let poses: Vec<Isometry3<f64>> =
            image.rows().iter().map(|row| world_from_scan * row.scan_from_sensor).collect();
        let place = |pose: &Isometry3<f64>| Point3::from(pose.translation.vector);
        if !poses.iter().any(|pose| self.at(&place(pose)).is_some())
            && let Some(off_m) = standing_out(image, &poses)
        {
            for pose in &poses {
                let place = place(pose);
                self.note(Sighting { place, range_m: place.coords.norm() + off_m });
            }
        }
        let mut taken = 0;
        for (row, pose) in poses.iter().enumerate() {
            let Some(phantom) = self.at(&place(pose)) else { continue };
            let seen: Vec<Return> = (0..image.columns()).map(|beam| image.at(row, beam)).collect();
            let bearings = image.bearings_rad.clone();
            let falls = |beam: usize| {
                let (sin, cos) = f64::sin_cos(bearings[beam]);
                -(pose.rotation * Vector3::new(cos, sin, 0.0)).z
            };
            for beam in phantom.among(&seen, falls) {
                image.forget(row, beam);
                taken += 1;
            }
        }
        taken
    }

    fn note(&mut self, sighting: Sighting) {
        self.sightings.retain(|other| (other.place - sighting.place).norm() > SAME_PLACE_M);
        if self.sightings.len() == KEPT {
            self.sightings.pop_front();
        }
        self.sightings.push_back(sighting);
    }

    /// The range at a place, as the nearest place tells.
    fn at(&self, place: &Point3<f64>) -> Option<Phantom> {
        let way_m = |sighting: &Sighting| (sighting.place - place).norm();
        let nearest = self.sightings.iter().min_by(|a, b| way_m(a).total_cmp(&way_m(b)))?;
        let from_origin_m = nearest.place.coords.norm();
        let is_level = (nearest.range_m - from_origin_m).abs() < LEVEL_WITHIN_M;
        let (change_m, unsure_m) = match is_level {
            true => (place.coords.norm() - from_origin_m, DRIFT * way_m(nearest)),
            false => (0.0, way_m(nearest)),
        };
        let phantom = Phantom { range_m: nearest.range_m + change_m, off_m: CUT_M + unsure_m };
        (phantom.off_m <= MOST_OFF_M).then_some(phantom)
    }
}

/// The range at one place, and what it may be off by.
struct Phantom {
    range_m: f64,
    off_m: f64,
}

impl Phantom {
    /// The beams that carry it. Of beams that meet no ground those are left that go on a surface to either
    /// side: a wall at that distance is likelier than a gap in it that looks just like it.
    fn among(&self, seen: &[Return], falls: impl Fn(usize) -> f64) -> Vec<usize> {
        let range = |beam: usize| match seen.get(beam) {
            Some(&Return::Hit(range_m)) => Some(range_m),
            _ => None,
        };
        let carries =
            |beam: usize| range(beam).is_some_and(|r| (r - self.range_m).abs() < self.off_m);
        let mut found = Vec::new();
        let mut beam = 0;
        while beam < seen.len() {
            let end = (beam..seen.len()).find(|&b| !carries(b)).unwrap_or(seen.len());
            let goes_on = |beside: Option<usize>| {
                let beside = beside.and_then(range);
                beside.is_some_and(|r| (r - self.range_m).abs() < SAME_SURFACE * self.range_m)
            };
            let on_surface = goes_on(beam.checked_sub(1)) && goes_on(Some(end));
            found.extend((beam..end).filter(|&beam| !on_surface || falls(beam) > LEVEL));
            beam = end.max(beam + 1);
        }
        found
    }
}

/// By how much the range that stands out among all rows is more than the distance to the map's origin.
///
/// Beams count that carry the same as the one beside them: a wall along the tilt's axis is seen at one range
/// by the same beam of all rows, but at another by the next.
fn standing_out(image: &RangeImage, poses: &[Isometry3<f64>]) -> Option<f64> {
    const BIN_M: f64 = 0.01;
    const ABOUT: usize = 10;
    let bins = (2.0 * LEVEL_WITHIN_M / BIN_M) as usize;
    let mut counts = vec![0_usize; bins];
    for (row, pose) in poses.iter().enumerate() {
        let from_origin_m = pose.translation.vector.norm();
        for beam in 1..image.columns() {
            let before = image.at(row, beam - 1);
            let (Return::Hit(before_m), Return::Hit(range_m)) = (before, image.at(row, beam))
            else {
                continue;
            };
            if (range_m - before_m).abs() > 0.5 * BIN_M {
                continue;
            }
            let bin = ((range_m - from_origin_m + LEVEL_WITHIN_M) / BIN_M).floor();
            if (0.0..bins as f64).contains(&bin) {
                counts[bin as usize] += 1;
            }
        }
    }
    let pairs: Vec<usize> = counts.windows(2).map(|pair| pair[0] + pair[1]).collect();
    let (at, &most) = pairs.iter().enumerate().max_by_key(|&(_, count)| count)?;
    let about = (at.saturating_sub(ABOUT)..pairs.len().min(at + ABOUT + 1))
        .filter(|&other| other.abs_diff(at) > 2)
        .map(|other| pairs[other])
        .max()
        .unwrap_or(0);
    let stands_out = most >= FEWEST && most >= STANDS_OUT * about.max(1);
    stands_out.then(|| BIN_M * (at + 1) as f64 - LEVEL_WITHIN_M)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::ImageRow;
    use crate::time::Stamp;
    use std::f64::consts::FRAC_PI_2;

    const BEAMS: usize = 181;

    /// A sensor `from` the level's origin, tilted down.
    fn sensor(from: [f64; 3], tilt_rad: f64) -> Isometry3<f64> {
        let place = nalgebra::Translation3::new(from[0], from[1], from[2]);
        Isometry3::from_parts(
            place,
            nalgebra::UnitQuaternion::from_euler_angles(0.0, tilt_rad, 0.0),
        )
    }

    /// A hall with walls to both sides, 3 m off, on a floor that ends `ends_m` ahead, where there is nothing
    /// below; beams beyond a wall's end hit nothing either. Cut to hundredths, half a step given back.
    fn line_of(pose: &Isometry3<f64>, ends_m: f64, gap: std::ops::Range<usize>) -> LaserLine {
        let step = std::f64::consts::PI / (BEAMS - 1) as f64;
        let origin = pose.translation.vector;
        let ranges_m = (0..BEAMS).map(|beam| {
            let (sin, cos) = (-FRAC_PI_2 + step * beam as f64).sin_cos();
            let direction = pose.rotation * Vector3::new(cos, sin, 0.0);
            let wall = 3.0 / direction.y.abs();
            let end = 9.0 / direction.x.max(1e-9);
            let floor = origin.z / (-direction.z).max(1e-9);
            let ground = if floor * direction.x < ends_m { floor } else { f64::INFINITY };
            let hit = if gap.contains(&beam) { f64::INFINITY } else { wall.min(end) }.min(ground);
            let range = if hit < 20.0 { hit } else { origin.norm() };
            (100.0 * range).floor() / 100.0 + 0.005
        });
        LaserLine {
            stamp: Stamp(1),
            first_bearing_rad: -FRAC_PI_2,
            bearing_step_rad: step,
            min_range_m: 0.1,
            max_range_m: 20.0,
            ranges_m: ranges_m.collect(),
            phantom_m: None,
        }
    }

    fn missing(line: &LaserLine) -> usize {
        line.ranges_m.iter().filter(|range| range.is_nan()).count()
    }

    #[test]
    fn what_one_line_shows_tells_of_a_few_beams_in_the_lines_about_it() {
        let mut watch = PhantomWatch::default();
        let here = sensor([6.0, 1.0, 0.6], 0.0);
        let few = line_of(&here, 20.0, 88..92);
        assert_eq!(missing(&watch.without(&few, &here)), 0, "nothing is known yet");
        let sure = LaserLine { phantom_m: Some(here.translation.vector.norm()), ..few.clone() };
        watch.without(&sure, &here);
        assert_eq!(missing(&watch.without(&few, &here)), 4);
        // As well from a little farther on, where it is another range.
        let there = sensor([6.4, 1.2, 0.6], 0.0);
        let few = line_of(&there, 20.0, 80..83);
        assert_eq!(missing(&watch.without(&few, &there)), 3);
        let far = sensor([8.5, 1.2, 0.6], 0.0);
        assert_eq!(missing(&watch.without(&line_of(&far, 20.0, 80..83), &far)), 0);
    }

    #[test]
    fn a_wall_at_that_distance_stays_and_ground_there_does_not() {
        let mut watch = PhantomWatch::default();
        let here = sensor([9.0, 0.0, 0.6], 0.0);
        watch.note(Sighting { place: Point3::new(9.0, 0.0, 0.6), range_m: 9.02 });
        let whole = line_of(&here, 20.0, 0..0);
        assert!(whole.ranges_m.iter().any(|range| (range - 9.02).abs() < 0.015));
        assert_eq!(missing(&watch.without(&whole, &here)), 0);
        // Ground that far might as well be none.
        let down = sensor([1.5, 0.0, 0.6], 0.381);
        watch.note(Sighting { place: Point3::new(1.5, 0.0, 0.6), range_m: 1.616 });
        let floor = watch.without(&line_of(&down, 20.0, 0..0), &down);
        assert!(floor.ranges_m[90].is_nan(), "{}", floor.ranges_m[90]);
    }

    #[test]
    fn few_beams_in_each_of_many_rows_stand_out_in_the_scan() {
        let world_from_robot = Isometry3::translation(5.0, 2.0, 0.0);
        let mut image = RangeImage::new(
            Isometry3::translation(0.0, 0.0, 0.6),
            (0..BEAMS).map(|beam| -FRAC_PI_2 + beam as f64 * 0.017_453_292_52).collect(),
            20.0,
        );
        let mut empty = 0;
        for i in -20..40 {
            let tilt_rad = 0.01 * f64::from(i);
            // The laser is carried 6 cm before the joint.
            let arm = sensor([0.0; 3], tilt_rad) * Isometry3::translation(0.06, 0.0, 0.02);
            let pose = world_from_robot * image.robot_from_scan * arm;
            let line = line_of(&pose, 4.0, 88..91);
            let row = ImageRow {
                tilt_rad,
                tilt_sigma_rad: 0.0,
                scan_from_sensor: arm,
                stamp: Some(Stamp(1)),
            };
            let phantom = (100.0 * pose.translation.vector.norm()).floor() / 100.0 + 0.005;
            empty += line.ranges_m.iter().filter(|r| (*r - phantom).abs() < 1e-9).count();
            image.push_line(row, &line);
        }
        let before = image.clone();
        let taken = PhantomWatch::default().take_from(&mut image, &world_from_robot);
        assert!((empty..empty + 120).contains(&taken), "{taken} of {empty}");
        let gone = |row| (88..91).all(|beam| image.at(row, beam) == Return::Missing);
        assert!((0..20).all(gone));
        // Of a hall without gaps nothing is taken.
        let mut whole = RangeImage::new(before.robot_from_scan, before.bearings_rad.clone(), 20.0);
        for row in before.rows() {
            let pose = world_from_robot * before.robot_from_scan * row.scan_from_sensor;
            whole.push_line(row.clone(), &line_of(&pose, 20.0, 0..0));
        }
        assert_eq!(PhantomWatch::default().take_from(&mut whole, &world_from_robot), 0);
    }
}
