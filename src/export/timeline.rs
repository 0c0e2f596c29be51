//! One ascending time for what a session stamped, whatever its server's clock did meanwhile.
//!
//! Truth and trajectory carry the stamps of one clock. When that clock is set back both have some
//! stamps twice, and only the order in which they were noted tells which of two places belongs to which.

use super::tum::TimedPose;

/// What lies between two samples of the truth at most, in seconds, and the rounding of stamps.
const SLACK_S: f64 = 0.25;

/// The runs of ascending stamps between settings back of a clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timeline {
    pieces: Vec<Piece>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    from_s: f64,
    to_s: f64,
    /// Added to its stamps, so that pieces follow one another.
    shift_s: f64,
}

impl Timeline {
    /// The timeline of a truth, in the order in which it was sampled.
    pub fn of(truth: &[TimedPose]) -> Self {
        let mut pieces: Vec<Piece> = Vec::new();
        for TimedPose { time_s, .. } in truth {
            match pieces.last_mut() {
                Some(piece) if *time_s >= piece.to_s => piece.to_s = *time_s,
                Some(piece) => {
                    let shift_s = piece.shift_s + piece.to_s + SLACK_S - time_s;
                    pieces.push(Piece { from_s: *time_s, to_s: *time_s, shift_s });
                }
                None => pieces.push(Piece { from_s: *time_s, to_s: *time_s, shift_s: 0.0 }),
            }
        }
        Self { pieces }
    }

    /// Whether the clock was never set back, so that stamps are as good as times.
    pub fn is_plain(&self) -> bool {
        self.pieces.len() < 2
    }

    /// Times in seconds on this line of stamps noted one after the other.
    pub fn times(&self, stamps: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let mut piece = 0;
        let mut before = f64::NEG_INFINITY;
        let mut time = |stamp: f64| {
            let runs_on = |p: &Piece| stamp >= before && stamp <= p.to_s + SLACK_S;
            let holds = |p: &Piece| stamp >= p.from_s - SLACK_S && stamp <= p.to_s + SLACK_S;
            if !self.pieces.get(piece).is_some_and(runs_on) {
                let later = self.pieces.iter().skip(piece + 1).position(holds);
                piece += later.map_or(0, |at| at + 1);
            }
            before = stamp;
            stamp + self.pieces.get(piece).map_or(0.0, |piece| piece.shift_s)
        };
        stamps.into_iter().map(&mut time).collect()
    }

    /// Poses noted one after the other, at their times on this line.
    pub fn unfolded(&self, poses: &[TimedPose]) -> Vec<TimedPose> {
        let times = self.times(poses.iter().map(|timed| timed.time_s));
        poses.iter().zip(times).map(|(timed, time_s)| TimedPose { time_s, ..*timed }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    /// Stamps of a clock that shows `offset_s(t)` more than the time `t`, every `every_s` up to 100 s.
    fn stamped(every_s: f64, offset_s: impl Fn(f64) -> f64) -> Vec<TimedPose> {
        let count = (100.0 / every_s) as u32;
        let times = (0..count).map(|i| f64::from(i) * every_s);
        let at = |t: f64| TimedPose {
            time_s: t + offset_s(t),
            pose: Isometry3::translation(t, 0.0, 0.0),
        };
        times.map(at).collect()
    }

    #[test]
    fn a_clock_set_back_is_unfolded_by_order() {
        for offset_s in [
            (|t: f64| if t < 50.0 { 0.0 } else { -100.0 }) as fn(f64) -> f64,
            |t| if t < 70.0 { 0.0 } else { -2.0 },
            |t| if (40.0..70.0).contains(&t) { 30.0 } else { 0.0 },
            |t| {
                if t < 20.0 {
                    0.0
                } else if t < 60.0 {
                    -15.0
                } else {
                    -30.0
                }
            },
        ] {
            let truth = stamped(0.2, offset_s);
            let line = Timeline::of(&truth);
            assert!(!line.is_plain());
            let truth = line.unfolded(&truth);
            assert!(truth.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
            // Whoever notes poses more seldom is at the same places at the same times.
            for own in line.unfolded(&stamped(0.77, offset_s)) {
                let pose = crate::export::score::at(&truth, own.time_s).unwrap();
                let off_m = (pose.translation.x - own.pose.translation.x).abs();
                assert!(off_m < 0.21, "{off_m} at {}", own.time_s);
            }
        }
    }

    #[test]
    fn a_clock_that_runs_on_is_left_alone() {
        let truth = stamped(0.2, |t| if t < 50.0 { 0.0 } else { 100.0 });
        let line = Timeline::of(&truth);
        assert!(line.is_plain());
        assert_eq!(line.times([3.0, 2.9, 150.0, 400.0]), vec![3.0, 2.9, 150.0, 400.0]);
        assert_eq!(Timeline::default().times([1.0, 0.5]), vec![1.0, 0.5]);
    }
}
