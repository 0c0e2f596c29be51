use crate::geometry::AngleSpan;
use crate::robot::GroundView;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::fmt;

/// A tilt on the grid of quarter degrees that all demanded tilts lie on; negative looks up.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct QuarterDegrees(pub i32);

/// One step of the grid in radians.
pub const QUARTER_DEGREE_RAD: f64 = PI / 720.0;

impl QuarterDegrees {
    /// The grid tilt nearest to an angle.
    pub fn nearest(tilt_rad: f64) -> Self {
        Self((tilt_rad / QUARTER_DEGREE_RAD).round() as i32)
    }

    /// The tilt in radians, negative up.
    pub fn radians(self) -> f64 {
        f64::from(self.0) * QUARTER_DEGREE_RAD
    }

    /// The tilt in degrees, negative up.
    pub fn degrees(self) -> f64 {
        f64::from(self.0) * 0.25
    }
}

impl fmt::Display for QuarterDegrees {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2}°", self.degrees())
    }
}

/// The list of tilts that a sweep visits, in order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// What reports call it.
    pub name: String,
    /// Tilts in order of acquisition.
    pub tilts: Vec<QuarterDegrees>,
}

/// What [`Profile::ground_fan`] has to cover.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FanConfig {
    /// Greatest distance between neighbouring rings on level ground straight ahead, in metres, above
    /// 0. Rings beyond about 7 m lie farther apart where one quarter degree does.
    pub ring_spacing_m: f64,
    /// Distance from the robot's centre of the nearest ring wanted, in metres: nearer ground is
    /// under the robot or its front bumper.
    pub nearest_m: f64,
    /// Distance from the robot's centre out to which rings are wanted, in metres.
    pub reach_m: f64,
    /// Height above the ground under which overhangs matter, in metres: the robot's own and a margin.
    pub overhang_height_m: f64,
}

impl Default for FanConfig {
    fn default() -> Self {
        Self { ring_spacing_m: 0.5, nearest_m: 0.45, reach_m: 8.0, overhang_height_m: 0.9 }
    }
}

/// The part of a profile that a link's limits cut off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Clipped {
    /// Rows lost.
    pub rows: usize,
    /// Steepest tilt asked for, and steepest left.
    pub steepest: (QuarterDegrees, Option<QuarterDegrees>),
    /// Highest tilt asked for (most negative), and highest left.
    pub highest: (QuarterDegrees, Option<QuarterDegrees>),
}

impl Profile {
    /// The paper's full sweep: -25.00° (up) to +29.75° (down) in 220 rows of 0.25°.
    pub fn paper_full() -> Self {
        Self { name: "paper".into(), tilts: (-100..=119).map(QuarterDegrees).collect() }
    }

    /// The paper's span in steps of `step_deg`, rounded to quarter degrees and at least one of them.
    pub fn coarse(step_deg: f64) -> Self {
        let step = ((step_deg * 4.0).round() as usize).max(1);
        let tilts = (-100..=119).step_by(step).map(QuarterDegrees).collect();
        Self { name: format!("coarse {:.2}°", step as f64 * 0.25), tilts }
    }

    /// Tilts whose lines on level ground lie at most a ring spacing apart, from the nearest ground
    /// wanted (or visible) out to the reach, and a few rows above for walls and overhangs.
    ///
    /// Ordered from the steepest tilt upwards. Empty for a laser that cannot tilt.
    pub fn ground_fan(view: &GroundView<'_>, config: &FanConfig) -> Self {
        let name = "ground fan".to_owned();
        let Some(limit) = view.steepest_tilt_rad() else {
            return Self { name, tilts: Vec::new() };
        };
        let wanted = view.tilt_for_ground_ahead(config.nearest_m).unwrap_or(limit);
        // Limits are inclusive, so the grid tilt at or above them, never one beyond.
        let steepest = (wanted.min(limit) / QUARTER_DEGREE_RAD + 1e-9).floor() as i32;
        let mut tilts = vec![QuarterDegrees(steepest)];
        let ahead = |tilt: QuarterDegrees| view.ground_ahead_m(tilt.radians());
        let mut last = QuarterDegrees(steepest);
        while let Some(distance) = ahead(last).filter(|&d| d < config.reach_m) {
            let mut next = QuarterDegrees(last.0 - 1);
            let within = |tilt: QuarterDegrees| {
                ahead(tilt).is_some_and(|d| d <= distance + config.ring_spacing_m)
            };
            while within(QuarterDegrees(next.0 - 1)) {
                next.0 -= 1;
            }
            tilts.push(next);
            last = next;
        }
        tilts.extend(overhang_rows(view, config, last));
        Self { name, tilts }
    }

    /// Whether there is nothing to visit.
    pub fn is_empty(&self) -> bool {
        self.tilts.is_empty()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.tilts.len()
    }

    /// The same rows, last one first.
    #[must_use]
    pub fn reversed(mut self) -> Self {
        self.tilts.reverse();
        self
    }

    /// The same rows, begun at the end that is nearer to where the tilt is, so that successive
    /// sweeps alternate their direction. A tie keeps the order.
    #[must_use]
    pub fn from_nearer_end(self, tilt_rad: f64) -> Self {
        let distance = |tilt: Option<&QuarterDegrees>| {
            tilt.map_or(0.0, |tilt| (tilt.radians() - tilt_rad).abs())
        };
        if distance(self.tilts.last()) < distance(self.tilts.first()) {
            self.reversed()
        } else {
            self
        }
    }

    /// The rows that a link can reach, and what is lost if some cannot.
    pub fn clipped(self, limits: Option<AngleSpan>) -> (Self, Option<Clipped>) {
        let Some(limits) = limits else { return (self, None) };
        // A limit printed with four decimals is cut, so a tilt on the limit may look beyond it.
        const CUT_RAD: f64 = 1e-4;
        let reachable = |tilt: &QuarterDegrees| {
            (limits.min_rad - CUT_RAD..=limits.max_rad + CUT_RAD).contains(&tilt.radians())
        };
        let kept: Vec<_> = self.tilts.iter().copied().filter(reachable).collect();
        if kept.len() == self.tilts.len() {
            return (self, None);
        }
        let bounds =
            |tilts: &[QuarterDegrees]| (tilts.iter().copied().max(), tilts.iter().copied().min());
        let (asked, left) = (bounds(&self.tilts), bounds(&kept));
        let clipped = Clipped {
            rows: self.tilts.len() - kept.len(),
            steepest: (asked.0.unwrap_or_default(), left.0),
            highest: (asked.1.unwrap_or_default(), left.1),
        };
        (Self { name: self.name, tilts: kept }, Some(clipped))
    }
}

/// Rows above the last ring: up to level for walls and obstacles, then tilts under which a thing at
/// the height of the robot is seen at half, a quarter, … of the reach.
fn overhang_rows(
    view: &GroundView<'_>,
    config: &FanConfig,
    last_ring: QuarterDegrees,
) -> Vec<QuarterDegrees> {
    let highest = view.head.tilt().and_then(|t| t.limits).map_or(f64::NEG_INFINITY, |l| l.min_rad);
    let above_m = config.overhang_height_m - view.laser_height_m();
    let level = [2, 1].map(|part| QuarterDegrees(last_ring.0 * part / 3));
    let up = [1.0, 0.5, 0.25, 0.125].map(|share| {
        QuarterDegrees::nearest(-(above_m.max(0.0) / (config.reach_m * share)).atan())
    });
    let mut rows: Vec<QuarterDegrees> = Vec::new();
    for tilt in level.into_iter().chain([QuarterDegrees(0)]).chain(up) {
        let above_all = rows.last().map_or(last_ring, |&row| row) > tilt;
        if above_all && tilt.radians() >= highest {
            rows.push(tilt);
        }
    }
    rows
}

impl Clipped {
    /// What is lost, in words; `view` tells which ground that is.
    pub fn explain(&self, view: &GroundView<'_>) -> String {
        let mut text = format!("the tilt's limits cut {} rows", self.rows);
        if self.steepest.1.is_none_or(|left| left < self.steepest.0) {
            let asked = view.ground_ahead_m(self.steepest.0.radians());
            let left = self.steepest.1.and_then(|tilt| view.ground_ahead_m(tilt.radians()));
            text += &match left {
                Some(left) => format!(": ground straight ahead is seen from {left:.1} m"),
                None => ": no ground straight ahead is seen".to_owned(),
            };
            text += &asked.map_or_else(String::new, |asked| format!(", not from {asked:.1} m"));
        }
        if self.highest.1.is_none_or(|left| left > self.highest.0) {
            let left = self.highest.1.map_or("none".to_owned(), |tilt| tilt.to_string());
            text += &format!("; highest row {left}, not {}", self.highest.0);
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Joint, JointKind, Mount, ScanHead};
    use nalgebra::Isometry3;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    fn head(limits_wire: Option<AngleSpan>) -> ScanHead {
        let mut tilt =
            Joint::from_wire("PT", 2, JointKind::Revolute, [0.1, 0.0, 0.4], [FRAC_PI_2, 0.0, 0.0]);
        tilt.limits = limits_wire;
        ScanHead::new(Mount {
            joints: vec![
                Joint::from_wire("PT", 1, JointKind::Revolute, [0.0; 3], [PI, 0.0, 0.0]),
                tilt,
            ],
            part_from_device: Isometry3::translation(0.04, 0.0, 0.05),
        })
    }

    fn view(head: &ScanHead) -> GroundView<'_> {
        GroundView { head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 }
    }

    #[test]
    fn the_papers_sweep_has_220_rows_from_minus_25_to_29_75_degrees() {
        let paper = Profile::paper_full();
        assert_eq!(paper.len(), 220);
        assert_eq!((paper.tilts[0].degrees(), paper.tilts[219].degrees()), (-25.0, 29.75));
        assert_eq!(Profile::coarse(2.0).len(), 28);
        assert_eq!(Profile::coarse(0.0), Profile { name: "coarse 0.25°".into(), ..paper });
    }

    #[test]
    fn limits_clip_the_sweep_and_the_warning_names_the_ground() {
        let head = head(Some(AngleSpan::new(-0.16, 0.40)));
        let limits = head.tilt().unwrap().limits;
        let (left, clipped) = Profile::paper_full().clipped(limits);
        assert_eq!((left.tilts[0].degrees(), left.tilts.last().unwrap().degrees()), (-22.75, 9.0));
        let text = clipped.unwrap().explain(&view(&head));
        assert_eq!(
            text,
            "the tilt's limits cut 92 rows: ground straight ahead is seen from 3.9 m, not from 1.2 m; \
             highest row -22.75°, not -25.00°"
        );
        assert_eq!(Profile::coarse(2.0).clipped(None).1, None);
        let up = self::head(Some(AngleSpan::new(0.1, 0.4)));
        let (_, clipped) = Profile::paper_full().clipped(up.tilt().unwrap().limits);
        let text = clipped.unwrap().explain(&view(&up));
        assert!(text.contains("no ground straight ahead is seen, not from 1.2 m"), "{text}");
    }

    #[test]
    fn a_sweep_begins_at_its_nearer_end() {
        let paper = Profile::paper_full();
        assert_eq!(paper.clone().from_nearer_end(0.5).tilts[0].degrees(), 29.75);
        assert_eq!(paper.clone().from_nearer_end(-0.5), paper);
    }

    #[test]
    fn a_fan_looks_up_to_the_robots_height() {
        let head = head(None);
        let fan = Profile::ground_fan(&view(&head), &FanConfig::default());
        assert!((20..=34).contains(&fan.len()), "{} rows", fan.len());
        let highest = fan.tilts.last().unwrap();
        let height_at_1_m = 0.6 + (-highest.radians()).tan();
        assert!(height_at_1_m > 0.85, "{height_at_1_m}");
    }

    proptest! {
        #[test]
        fn rings_of_a_fan_lie_no_farther_apart_than_asked(
            lowest in 0.1..1.2f64, spacing in 0.3..1.0f64, reach in 3.0..8.0f64
        ) {
            let head = head(Some(AngleSpan::new(-lowest, 0.5)));
            let view = view(&head);
            let config = FanConfig { ring_spacing_m: spacing, reach_m: reach, ..FanConfig::default() };
            let fan = Profile::ground_fan(&view, &config);
            prop_assert!(fan.clone().clipped(head.tilt().unwrap().limits).1.is_none());
            let rings: Vec<f64> =
                fan.tilts.iter().map_while(|t| view.ground_ahead_m(t.radians())).collect();
            prop_assert!(fan.tilts.windows(2).all(|w| w[1] < w[0]), "from the steepest upwards");
            for pair in rings.windows(2).filter(|pair| pair[0] < reach) {
                let one_step = pair[0] > 5.0 && pair[1] - pair[0] < 0.06 * pair[0] * pair[0];
                prop_assert!(pair[1] - pair[0] <= spacing + 1e-9 || one_step, "{pair:?}");
            }
            prop_assert!(rings.iter().any(|&d| d >= reach), "out to the reach");
        }
    }
}
