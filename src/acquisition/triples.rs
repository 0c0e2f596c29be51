//! Records of triples: their text, and the sweeps in them.

use super::cyclic::{CyclicSource, Triple};
use super::tilt_mount::TiltMount;
use crate::geometry::lie::se3_between;
use crate::scan::LaserLine;
use crate::time::{Span, Stamp};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::fmt::Write as _;
use std::ops::Range;

#[doc = include_str!("../guide/triples.md")]
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedTriples {
    triples: Vec<Triple>,
    mount: Option<TiltMount>,
    next: usize,
    tilt_late: Span,
    pose_late: Span,
    remarks: Vec<String>,
}

/// Why a record of triples cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TripleError {
    /// The first line is not the heading.
    #[error("line 1: expected `{HEADING}`")]
    Heading,
    /// A line holds neither a triple nor a mount.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
}

/// First line of a record.
pub const HEADING: &str = "usar triples 1";
/// First word of the line that tells where the laser sits.
const MOUNT: &str = "mount";
/// Turns smaller than this from triple to triple are rest: readings have four decimals.
const RESTING_RAD: f64 = 2e-4;
/// A sweep at rest at every row waits no longer for a row.
const LONGEST_REST: Span = Span::from_millis(2_000);
/// Fewer rows do not make a scan.
const FEWEST_TRIPLES: usize = 8;
/// A smaller swing is a head on its way to somewhere, in radians: five degrees.
const LEAST_SWING_RAD: f64 = 0.0873;
/// Numbers before the ranges of a line: stamp, place, orientation, tilt, and the laser's geometry.
const FIXED: usize = 13;

impl RecordedTriples {
    /// A record of `triples`, put in order of time. Of triples of one time the first is kept, and of
    /// lines of different lengths those that are as long as most.
    pub fn new(triples: Vec<Triple>) -> Self {
        Self::in_order(triples.into_iter().map(|triple| (None, triple)).collect())
    }

    /// The same of triples with the numbers of their lines in a file.
    fn in_order(mut numbered: Vec<(Option<usize>, Triple)>) -> Self {
        let mut remarks = Vec::new();
        let place = |(number, triple): &(Option<usize>, Triple)| {
            let at = format!("at {:.3} s", triple.stamp.seconds());
            number.map_or(at.clone(), |number| format!("line {number}, {at}"))
        };
        let mut counted = |odd: &[String], what: &str| {
            if let Some(first) = odd.first() {
                remarks.push(format!("{} {what} (the first: {first})", odd.len()));
            }
        };
        let mut latest = Stamp(i64::MIN);
        let mut backward = Vec::new();
        for row in &numbered {
            if row.1.stamp < latest {
                backward.push(place(row));
            }
            latest = latest.max(row.1.stamp);
        }
        counted(&backward, "triples stand behind later ones: put in order");
        numbered.sort_by_key(|(_, triple)| triple.stamp);
        let (mut again, mut last) = (Vec::new(), None);
        numbered.retain(|row| {
            let is_new = last != Some(row.1.stamp);
            last = Some(row.1.stamp);
            if !is_new {
                again.push(place(row));
            }
            is_new
        });
        counted(&again, "triples have the time of another one: left out");
        let mut lengths = std::collections::BTreeMap::<usize, usize>::new();
        numbered.iter().for_each(|(_, t)| *lengths.entry(t.line.len()).or_default() += 1);
        // Of lengths that are equally frequent the greatest: the others were cut.
        let usual = lengths.iter().max_by_key(|&(&length, &count)| (count, length));
        let usual = usual.map_or(0, |(&length, _)| length);
        let mut other = Vec::new();
        numbered.retain(|row| {
            let beams = row.1.line.len();
            if beams != usual {
                other.push(format!("{}, {beams} beams", place(row)));
            }
            beams == usual
        });
        counted(&other, &format!("lines have another number of beams than {usual}: left out"));
        let triples = numbered.into_iter().map(|(_, triple)| triple).collect();
        Self { triples, remarks, ..Self::default() }
    }

    /// What was odd about the record, in words for a user, with counts; empty as a rule.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// The same record with tilts `tilt_late` and poses `pose_late` later than their lines, either of
    /// them negative for earlier; times beyond the record are those of its ends.
    #[must_use]
    pub fn desynchronised(self, tilt_late: Span, pose_late: Span) -> Self {
        Self { tilt_late, pose_late, next: 0, ..self }
    }

    /// The same record with the laser on `mount`.
    #[must_use]
    pub fn on(self, mount: TiltMount) -> Self {
        Self { mount: Some(mount), ..self }
    }

    /// Where the laser sits, if the record tells.
    pub fn mount(&self) -> Option<&TiltMount> {
        self.mount.as_ref()
    }

    /// The triples, in order of time.
    pub fn triples(&self) -> &[Triple] {
        &self.triples
    }

    /// Reads a record, in the form described above.
    ///
    /// # Errors
    ///
    /// Where the text is no such record.
    pub fn parse(text: &str) -> Result<Self, TripleError> {
        let mut lines = text.lines().enumerate();
        if lines.next().map(|(_, line)| line.trim()) != Some(HEADING) {
            return Err(TripleError::Heading);
        }
        let (mut triples, mut mount) = (Vec::new(), None);
        for (at, line) in lines {
            let line = line.trim();
            let wrong = |what| TripleError::Line { line: at + 1, what };
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            match line.strip_prefix(MOUNT) {
                Some(_) if mount.is_some() => {
                    return Err(wrong("a second mount; a record has one".to_owned()));
                }
                Some(rest) => mount = Some(mount_of(rest).map_err(wrong)?),
                None => triples.push((Some(at + 1), triple_of(line).map_err(wrong)?)),
            }
        }
        Ok(Self { mount, ..Self::in_order(triples) })
    }

    /// The record as text, as [`RecordedTriples::parse`] reads it.
    pub fn to_text(&self) -> String {
        let mut text = format!("{HEADING}\n");
        if let Some(TiltMount { robot_from_axis, axis_from_laser }) = &self.mount {
            let (axis, laser) = (pose_text(robot_from_axis), pose_text(axis_from_laser));
            text += &format!("{MOUNT} {axis} {laser}\n");
        }
        for Triple { stamp, frame_from_robot, tilt_rad, line } in &self.triples {
            // Writing to a string cannot fail.
            let _ = write!(
                text,
                "{:.6} {} {tilt_rad} {} {} {} {}",
                stamp.seconds(),
                pose_text(frame_from_robot),
                line.first_bearing_rad,
                line.bearing_step_rad,
                line.min_range_m,
                line.max_range_m,
            );
            for range in &line.ranges_m {
                let _ = write!(text, " {range}");
            }
            text.push('\n');
        }
        text
    }

    /// The stretches of the record in which the tilt turns one way: what a scan can be made of. A rest
    /// longer than two seconds parts two of them; a swing of less than five degrees or of fewer than
    /// eight triples is none.
    pub fn sweeps(&self) -> Vec<Range<usize>> {
        let mut found = Vec::new();
        let (mut begin, mut end, mut direction) = (0, 0, 0.0);
        for at in 1..self.triples.len() {
            let (last, here) = (&self.triples[end], &self.triples[at]);
            let turn = here.tilt_rad - last.tilt_rad;
            if turn.abs() < RESTING_RAD {
                continue;
            }
            let goes_on = turn * direction > 0.0 && here.stamp - last.stamp <= LONGEST_REST;
            if !goes_on {
                found.push(begin..end + 1);
                // The tilt left where it was last seen, at the triple before this one; unless that was
                // before a gap in the record.
                let gap = here.stamp - self.triples[at - 1].stamp > LONGEST_REST;
                begin = if gap { at } else { at - 1 };
            }
            (end, direction) = (at, turn);
        }
        found.push(begin..end + 1);
        found.retain(|sweep| {
            let (Some(first), Some(last)) =
                (self.triples.get(sweep.start), self.triples.get(sweep.end - 1))
            else {
                return false;
            };
            sweep.len() >= FEWEST_TRIPLES
                && (last.tilt_rad - first.tilt_rad).abs() >= LEAST_SWING_RAD
        });
        found
    }

    /// Tilt and pose at `stamp`, interpolated; those of the ends beyond them.
    fn between(&self, stamp: Stamp) -> (f64, Isometry3<f64>) {
        let after = self.triples.partition_point(|triple| triple.stamp <= stamp);
        let last = self.triples.len() - 1;
        let (a, b) = (&self.triples[after.saturating_sub(1)], &self.triples[after.min(last)]);
        let seconds = (b.stamp - a.stamp).seconds();
        let share = if seconds > 0.0 { (stamp - a.stamp).seconds() / seconds } else { 0.0 };
        let share = share.clamp(0.0, 1.0);
        (
            a.tilt_rad + share * (b.tilt_rad - a.tilt_rad),
            se3_between(&a.frame_from_robot, &b.frame_from_robot, share),
        )
    }
}

impl CyclicSource for RecordedTriples {
    fn request(&mut self, due: Stamp) -> Option<Triple> {
        let ahead = self.triples[self.next..].iter().position(|triple| triple.stamp >= due)?;
        let at = self.next + ahead;
        self.next = at + 1;
        let mut triple = self.triples[at].clone();
        if self.tilt_late != Span::ZERO {
            triple.tilt_rad = self.between(triple.stamp + self.tilt_late).0;
        }
        if self.pose_late != Span::ZERO {
            triple.frame_from_robot = self.between(triple.stamp + self.pose_late).1;
        }
        Some(triple)
    }
}

/// A pose as a record has it: x y z in metres, then the quaternion w x y z.
fn pose_text(pose: &Isometry3<f64>) -> String {
    // Twelve decimals: the rest is rounding errors of the arithmetic. Adding zero makes -0 of them 0.
    let tidy = |value: f64| (value * 1e12).round() / 1e12 + 0.0;
    let t = pose.translation.vector.map(tidy);
    let q = pose.rotation.quaternion().coords.map(tidy);
    format!("{} {} {} {} {} {} {}", t.x, t.y, t.z, q.w, q.x, q.y, q.z)
}

fn pose_of([x, y, z, qw, qx, qy, qz]: [f64; 7]) -> Result<Isometry3<f64>, String> {
    let orientation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6)
        .ok_or_else(|| "an orientation is zero".to_owned())?;
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), orientation))
}

fn numbers_of(text: &str) -> Result<Vec<f64>, String> {
    let number = |word: &str| match word.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        Ok(_) => Err(format!("`{word}` is not finite")),
        Err(_) => Err(format!("`{word}` is no number")),
    };
    text.split_ascii_whitespace().map(number).collect()
}

fn mount_of(rest: &str) -> Result<TiltMount, String> {
    let numbers = numbers_of(rest)?;
    let found = numbers.len();
    let all = <[f64; 14]>::try_from(numbers)
        .map_err(|_| format!("a mount of {found} numbers, expected 14: two poses"))?;
    let [x, y, z, qw, qx, qy, qz, lx, ly, lz, lqw, lqx, lqy, lqz] = all;
    Ok(TiltMount {
        robot_from_axis: pose_of([x, y, z, qw, qx, qy, qz])?,
        axis_from_laser: pose_of([lx, ly, lz, lqw, lqx, lqy, lqz])?,
    })
}

/// Whether a number lies where one of its kind can.
fn sane(what: &str, value: f64, most: f64, unit: &str) -> Result<(), String> {
    match value.abs() <= most {
        true => Ok(()),
        false => Err(format!("{what} of {value} {unit}: expected at most {most:.6} {unit}")),
    }
}

fn triple_of(line: &str) -> Result<Triple, String> {
    let numbers = numbers_of(line)?;
    let Some((fixed, ranges)) = numbers.split_first_chunk::<FIXED>() else {
        return Err(format!("{} numbers, expected at least {FIXED}", numbers.len()));
    };
    if ranges.is_empty() {
        return Err("a triple without a range".to_owned());
    }
    let &[stamp, x, y, z, qw, qx, qy, qz, tilt_rad, first_bearing_rad, bearing_step_rad, min, max] =
        fixed;
    sane("a time", stamp, 1e9, "s")?;
    [x, y, z].into_iter().try_for_each(|along| sane("a place", along, 1e6, "m"))?;
    sane("a tilt", tilt_rad, std::f64::consts::PI, "rad")?;
    sane("a first bearing", first_bearing_rad, 2.0 * std::f64::consts::PI, "rad")?;
    sane("a step of bearings", bearing_step_rad, std::f64::consts::PI, "rad")?;
    sane("a greatest distance", max, 1e4, "m")?;
    if bearing_step_rad == 0.0 || min < 0.0 || max <= min {
        return Err(format!(
            "beams {bearing_step_rad} rad apart that measure from {min} to {max} m are none"
        ));
    }
    for (beam, &range) in ranges.iter().enumerate() {
        // Servers print a beam without return somewhat beyond the greatest distance, or as -1.
        if range < -1.0 || range > 10.0 * max {
            return Err(format!("distance {} is {range} m, the greatest is {max} m", beam + 1));
        }
    }
    let stamp = Stamp::from_seconds(stamp);
    Ok(Triple {
        stamp,
        frame_from_robot: pose_of([x, y, z, qw, qx, qy, qz])?,
        tilt_rad,
        line: LaserLine {
            stamp,
            first_bearing_rad,
            bearing_step_rad,
            min_range_m: min,
            max_range_m: max,
            phantom_m: None,
            ranges_m: ranges.to_vec(),
        },
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::testbed::{World, head, line_at};
    use super::*;
    use crate::robot::HeadPose;
    use nalgebra::Vector3;

    /// A sweep down at 0.05 rad/s before a room, driven through at 0.2 m/s.
    pub(in super::super) fn record() -> RecordedTriples {
        let head = head(None, None);
        let triples = (0..60).map(|i| {
            let t = 0.2 * f64::from(i);
            let tilt_rad = 0.05 * t - 0.2;
            let mut line = line_at(&World::default(), &head, HeadPose::tilted(tilt_rad), 1.0);
            line.stamp = Stamp::from_seconds(100.0 + t);
            let place = Vector3::new(0.2 * t, 0.0, 0.0);
            let frame_from_robot = Isometry3::new(place, Vector3::new(0.0, 0.0, 0.01 * t));
            Triple { stamp: line.stamp, frame_from_robot, tilt_rad, line }
        });
        RecordedTriples::new(triples.collect())
    }

    #[test]
    fn a_record_is_read_as_it_was_written() {
        let mount = TiltMount::of(&head(None, None)).unwrap();
        let record = record().on(mount.clone());
        let text = record.to_text().replace("mount", "\n# a remark\nmount");
        let again = RecordedTriples::parse(&text).unwrap();
        let off = |tilt_rad| {
            let here = again.mount().unwrap().robot_from_laser(tilt_rad);
            (here.inverse() * mount.robot_from_laser(tilt_rad)).translation.vector.norm()
        };
        assert!(off(0.0) < 1e-12 && off(0.4) < 1e-12);
        assert_eq!(again.triples().len(), 60);
        for (a, b) in record.triples().iter().zip(again.triples()) {
            assert_eq!((a.stamp, a.tilt_rad, &a.line), (b.stamp, b.tilt_rad, &b.line));
            assert!(a.frame_from_robot.rotation.angle_to(&b.frame_from_robot.rotation) < 1e-12);
        }
        assert_eq!(RecordedTriples::parse("triples"), Err(TripleError::Heading));
        let cut = RecordedTriples::parse("usar triples 1\n1 2 x").unwrap_err();
        assert_eq!(cut.to_string(), "line 2: `x` is no number");
        let short = RecordedTriples::parse("usar triples 1\nmount 1 2 3").unwrap_err();
        assert_eq!(short.to_string(), "line 2: a mount of 3 numbers, expected 14: two poses");
        let bare = "usar triples 1\n1 0 0 0 1 0 0 0 0.1 -1.57 0.0174 0.1 20\n";
        let bare = RecordedTriples::parse(bare).unwrap_err();
        assert_eq!(bare.to_string(), "line 2: a triple without a range");
    }

    #[test]
    fn the_record_of_the_guide_is_one() {
        let page = include_str!("../guide/triples.md");
        let record = page.split("```text\n").nth(1).unwrap().split("```").next().unwrap();
        let record = RecordedTriples::parse(record).unwrap();
        assert_eq!((record.triples().len(), record.triples()[0].line.len()), (2, 5));
        let laser = record.mount().unwrap().robot_from_laser(0.0);
        assert!((laser.translation.vector - Vector3::new(0.19, 0.0, 0.31)).norm() < 1e-12);
    }

    #[test]
    fn a_sweep_is_a_swing_one_way() {
        let line = record().triples()[0].line.clone();
        let at = |(i, tilt_rad): (usize, f64)| Triple {
            stamp: Stamp::from_seconds(0.2 * i as f64),
            frame_from_robot: Isometry3::identity(),
            tilt_rad,
            line: line.clone(),
        };
        // Rest, down with a rest of three lines, up, a nudge that is none.
        let mut tilts = vec![-0.2; 5];
        tilts.extend((1..=10).map(|i| -0.2 + 0.02 * f64::from(i)));
        tilts.extend([0.0; 3]);
        tilts.extend((1..=10).map(|i| 0.02 * f64::from(i)));
        tilts.extend((1..=10).map(|i| 0.2 - 0.02 * f64::from(i)));
        tilts.extend((1..=10).map(|i| 0.002 * f64::from(i)));
        let record = RecordedTriples::new(tilts.into_iter().enumerate().map(at).collect());
        assert_eq!(record.sweeps(), [4..28, 27..38]);
        assert!(RecordedTriples::default().sweeps().is_empty());
    }

    #[test]
    fn a_gap_in_the_record_ends_a_sweep() {
        let mut triples = record().triples().to_vec();
        for triple in &mut triples[30..] {
            triple.stamp = triple.stamp + Span::from_millis(1_000_000);
        }
        assert_eq!(RecordedTriples::new(triples).sweeps(), [0..30, 30..60]);
    }

    #[test]
    fn triples_of_one_time_out_of_order_or_of_another_length_are_counted_and_told() {
        let mut text = record().to_text();
        let lines: Vec<String> = text.lines().map(str::to_owned).collect();
        text += &format!("{}\n", lines[3]);
        let cut: Vec<&str> = lines[4].split(' ').collect();
        text += &format!("100.05 {}\n", cut[1..cut.len() - 4].join(" "));
        let record = RecordedTriples::parse(&text).unwrap();
        assert_eq!(record.triples().len(), 60);
        let remarks = record.remarks();
        assert_eq!(remarks.len(), 3, "{remarks:?}");
        assert!(remarks[0].starts_with("2 triples stand behind later ones"), "{remarks:?}");
        assert!(remarks[1].starts_with("1 triples have the time of another one"), "{remarks:?}");
        assert!(remarks[1].contains("line 62"), "{remarks:?}");
        assert!(remarks[2].contains("line 63") && remarks[2].contains("57 beams"), "{remarks:?}");
        assert_eq!(super::super::triples::tests::record().remarks(), [""; 0]);
    }

    #[test]
    fn absurd_numbers_are_named_with_their_line() {
        let with = |stamp: &str, tilt: &str, range: &str| {
            let text = format!(
                "usar triples 1\n{stamp} 0 0 0 1 0 0 0 {tilt} -1.57 0.0174 0.1 20 2.5 {range}\n"
            );
            RecordedTriples::parse(&text).map_err(|error| error.to_string())
        };
        assert!(with("1", "0.1", "3").is_ok());
        let why = with("1", "50", "3").unwrap_err();
        assert_eq!(why, "line 2: a tilt of 50 rad: expected at most 3.141593 rad");
        let why = with("1", "0.1", "1e300").unwrap_err();
        assert!(why.starts_with("line 2: distance 2 is 1") && why.ends_with("is 20 m"), "{why}");
        assert_eq!(with("1", "0.1", "NaN").unwrap_err(), "line 2: `NaN` is not finite");
        assert!(with("1e300", "0.1", "3").unwrap_err().starts_with("line 2: a time of"));
    }

    #[test]
    fn a_desynchronised_record_is_off_by_speed_times_delay() {
        let late = Span::from_millis(100);
        let mut record = record().desynchronised(late, late);
        let triple = record.request(Stamp::from_seconds(104.0)).unwrap();
        assert!((triple.tilt_rad - 0.005).abs() < 1e-9, "{}", triple.tilt_rad);
        assert!((triple.frame_from_robot.translation.x - 0.82).abs() < 1e-4);
    }
}
