//! Which sweep to take: the one that shows most in the time it takes, and why.

use super::config::AcquisitionConfig;
use super::control::HeadControl;
use super::profile::{FanConfig, Profile, QuarterDegrees};
use super::servo::ServoLaw;
use super::way::StepLimit;
use super::{SweepMode, SweepRequest};
use crate::robot::GroundView;
use serde::{Deserialize, Serialize};

/// Width of the rings of an [`Interest`], in metres.
pub const RING_M: f64 = 0.25;

/// What a sweep from here could still show, by distance from the robot's centre.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Interest {
    /// Ground in sight that was not seen well enough, in m², ring by ring of [`RING_M`].
    pub unseen_m2: Vec<f64>,
    /// Distances, least and greatest in metres, in order, that must get fine rows before the robot
    /// drives there: suspected edges, and unknown ground in the way.
    pub required_m: Vec<(f64, f64)>,
}

impl Interest {
    /// Adds `area_m2` of unseen ground `distance_m` away.
    pub fn add(&mut self, distance_m: f64, area_m2: f64) {
        let ring = (distance_m.max(0.0) / RING_M) as usize;
        if self.unseen_m2.len() <= ring {
            self.unseen_m2.resize(ring + 1, 0.0);
        }
        self.unseen_m2[ring] += area_m2;
    }

    /// Demands fine rows `distance_m` away.
    pub fn require(&mut self, distance_m: f64) {
        let mut here = (distance_m - 0.5 * RING_M, distance_m + 0.5 * RING_M);
        // Stretches that touch are one.
        self.required_m.retain(|&(a, b)| {
            let touches = a <= here.1 && here.0 <= b;
            if touches {
                here = (here.0.min(a), here.1.max(b));
            }
            !touches
        });
        let at = self.required_m.partition_point(|stretch| stretch.0 < here.0);
        self.required_m.insert(at, here);
    }

    /// Unseen ground that the rows of `profile` show, in m²: where they lie farther apart than
    /// `spacing_m`, the share that they leave known.
    pub(super) fn shown_m2(&self, profile: &Profile, view: &GroundView<'_>, spacing_m: f64) -> f64 {
        let ahead = |tilt: &QuarterDegrees| view.ground_ahead_m(tilt.radians());
        let mut rings: Vec<f64> = profile.tilts.iter().filter_map(ahead).collect();
        rings.sort_by(f64::total_cmp);
        let share = |at_m: f64| {
            let beyond = rings.partition_point(|&ring| ring <= at_m);
            match (beyond.checked_sub(1).map(|i| rings[i]), rings.get(beyond)) {
                (Some(near), Some(&far)) => (spacing_m / (far - near).max(1e-6)).min(1.0),
                _ => 0.0,
            }
        };
        let middle_m = |ring: usize| (ring as f64 + 0.5) * RING_M;
        let shown = self.unseen_m2.iter().enumerate();
        // Adding zero makes the -0 of an empty sum 0.
        shown.map(|(ring, area)| share(middle_m(ring)) * area).sum::<f64>() + 0.0
    }
}

/// A sweep that was chosen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offer {
    /// What to ask for.
    pub request: SweepRequest,
    /// How long it should take, in seconds.
    pub seconds: f64,
    /// Unseen ground that it should show, in m².
    pub gain_m2: f64,
    /// Why this one, in plain words.
    pub reason: String,
}

/// How fast rows can be taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// Whether motion and laser overlap, and then how fast.
    flowing: Option<StepLimit>,
    law: Option<ServoLaw>,
    interval_s: f64,
    tolerance_rad: f64,
    unknown_settle_s: f64,
    /// What a command takes to be obeyed.
    obeyed_s: f64,
}

impl Pace {
    pub(super) fn of(control: &HeadControl, config: &AcquisitionConfig, flowing: bool) -> Self {
        Self {
            flowing: flowing.then(|| StepLimit::of(control, config)),
            law: control.tilt.law(),
            interval_s: control.rhythm.interval().seconds(),
            tolerance_rad: config.coarse_tolerance_deg.to_radians(),
            unknown_settle_s: config.unknown_settle_s,
            obeyed_s: control.obeyed_within().seconds(),
        }
    }

    fn travel_s(&self, angle_rad: f64) -> f64 {
        match self.law {
            Some(ServoLaw::Hinge { speed_rad_s, .. }) => angle_rad.abs() / speed_rad_s,
            // A spring gets anywhere within a few of its own periods, which rows outlast.
            Some(ServoLaw::Spring { .. }) | None => 0.0,
        }
    }

    /// Seconds that a sweep over `profile` takes, begun with the tilt at `tilt_rad`.
    pub(super) fn seconds(&self, profile: &Profile, tilt_rad: f64) -> f64 {
        let tilts = &profile.tilts;
        let Some(first) = tilts.first() else { return 0.0 };
        let settle = |step_rad: f64| {
            self.law.map_or(self.unknown_settle_s, |law| law.settle_s(step_rad, self.tolerance_rad))
        };
        let row_s = |step_rad: f64| match self.flowing {
            Some(limit) => {
                let lines = step_rad.abs() / limit.step(step_rad.abs()).max(1e-9);
                self.travel_s(step_rad).max(self.interval_s * lines.max(1.0))
            }
            // The line after the one during which the tilt came to rest.
            None => {
                let rests_s = self.obeyed_s + settle(step_rad);
                ((rests_s / self.interval_s).ceil() + 1.0) * self.interval_s
            }
        };
        let approach_rad = first.radians() - tilt_rad;
        let rows: f64 = tilts.windows(2).map(|w| row_s(w[1].radians() - w[0].radians())).sum();
        settle(approach_rad).max(self.travel_s(approach_rad)) + self.interval_s + rows
    }
}

/// Distances from which on a fan of interest may begin, in metres.
const CUTS_M: [f64; 6] = [0.75, 1.0, 1.5, 2.0, 3.0, 4.0];
/// Name of the fan that leaves nothing out.
const WHOLE: &str = "ground fan";
/// Worth of the walls in a sweep, in m² of ground: what it is taken for where no ground is unseen.
pub(super) const WALLS_M2: f64 = 4.0;
/// Distance between rings where fine rows are required, in metres: a third of a wheel's width more
/// and an edge could hide between two of them.
const FINE_RING_M: f64 = 0.1;

/// The sweep that shows most per second, the `between_s` seconds counted that pass anyway from one sweep
/// to the next: what is left out here has to be driven to once more. It is chosen among the whole fan,
/// fans of interest, a coarse fan, and the whole height in coarse or in fine rows; every one of them with
/// the fine rows that `interest` requires. `None` for a laser that cannot tilt.
pub(super) fn choose(
    view: &GroundView<'_>,
    config: &FanConfig,
    interest: &Interest,
    pace: &Pace,
    (tilt_rad, between_s): (f64, f64),
) -> Option<Offer> {
    let mode = match pace.flowing {
        Some(_) => SweepMode::Flowing,
        None => SweepMode::Settled { tolerance_rad: pace.tolerance_rad },
    };
    // What a profile shows is what is left of it within the tilt's reach.
    let offer = |name: &str, profile: Profile| {
        let profile = with_fine_rows(reachable(profile, view), view, interest);
        let profile = Profile { name: name.to_owned(), ..profile }.from_nearer_end(tilt_rad);
        let seconds = pace.seconds(&profile, tilt_rad);
        let gain_m2 = interest.shown_m2(&profile, view, config.ring_spacing_m);
        let some = !profile.is_empty();
        let request = SweepRequest { profile, pan_rad: 0.0, mode };
        some.then(|| Offer { request, seconds, gain_m2, reason: name.to_owned() })
    };
    let fan = |fan: &FanConfig| Profile::ground_fan(view, fan);
    let cuts = CUTS_M.iter().filter(|&&cut| cut > config.nearest_m && cut < 0.6 * config.reach_m);
    let from = |&nearest_m: &f64| {
        let fan = fan(&FanConfig { nearest_m, ..config.clone() });
        (format!("fan from {nearest_m} m"), fan)
    };
    let wide = FanConfig { ring_spacing_m: 2.0 * config.ring_spacing_m, ..config.clone() };
    // Of equal ones the first: the whole fan, then the widest.
    let offers: Vec<Offer> = std::iter::once((WHOLE.to_owned(), fan(config)))
        .chain(cuts.map(from))
        .chain([
            ("coarse fan".to_owned(), fan(&wide)),
            ("coarse sweep".to_owned(), Profile::coarse(2.0)),
            ("full sweep".to_owned(), Profile::paper_full()),
        ])
        .filter_map(|(name, profile)| offer(&name, profile))
        .collect();
    let per_second = |offer: &Offer| (offer.gain_m2 + WALLS_M2) / (offer.seconds + between_s);
    let best_of = |offers: &mut dyn Iterator<Item = &Offer>| {
        let better = |a, b| if per_second(b) > per_second(a) { b } else { a };
        offers.reduce(better).cloned()
    };
    let mut best = best_of(&mut offers.iter())?;
    let second = best_of(&mut offers.iter().filter(|other| other.reason != best.reason));
    let told = |offer: &Offer| format!("{:.1} m² in {:.1} s", offer.gain_m2, offer.seconds);
    let named = |offer: &Offer| format!("{} {}", offer.reason, told(offer));
    let whole = offers.first().filter(|whole| whole.reason == WHOLE && best.reason != WHOLE);
    let against = match (whole, second) {
        (Some(whole), Some(second)) if second.reason != WHOLE => {
            format!("the whole fan {}, {}", told(whole), named(&second))
        }
        (Some(whole), _) => format!("the whole fan {}", told(whole)),
        (None, Some(second)) => {
            format!("no other shows more per second (next: {})", named(&second))
        }
        (None, None) => "nothing else can be shown".to_owned(),
    };
    let fine = match interest.required_m.is_empty() {
        true => String::new(),
        false => {
            let stretches = interest.required_m.iter().map(|(a, b)| format!("{a:.1} to {b:.1} m"));
            format!("; fine rows at {}", stretches.collect::<Vec<_>>().join(", "))
        }
    };
    best.reason = format!("{}: {}, {against}{fine}", best.reason, told(&best));
    Some(best)
}

/// `profile` with rows at most [`FINE_RING_M`] apart, or a quarter of a degree, where they are
/// required; the steepest first.
pub(super) fn with_fine_rows(
    mut profile: Profile,
    view: &GroundView<'_>,
    interest: &Interest,
) -> Profile {
    let Some(limit) = view.steepest_tilt_rad() else { return profile };
    let steepest = (limit / super::QUARTER_DEGREE_RAD + 1e-9).floor() as i32;
    let ahead = |tilt: QuarterDegrees| view.ground_ahead_m(tilt.radians());
    for &(near_m, far_m) in &interest.required_m {
        let Some(tilt_rad) = view.tilt_for_ground_ahead(near_m.max(0.0)) else { continue };
        let mut tilt = QuarterDegrees((tilt_rad / super::QUARTER_DEGREE_RAD) as i32);
        tilt.0 = tilt.0.min(steepest);
        while let Some(distance_m) = ahead(tilt).filter(|&d| d <= far_m) {
            profile.tilts.push(tilt);
            tilt.0 -= 1;
            while ahead(QuarterDegrees(tilt.0 - 1)).is_some_and(|d| d <= distance_m + FINE_RING_M) {
                tilt.0 -= 1;
            }
        }
        profile.tilts.push(tilt);
    }
    profile.tilts.sort_by_key(|tilt| std::cmp::Reverse(*tilt));
    profile.tilts.dedup();
    reachable(profile, view)
}

/// The rows of `profile` within the tilt's reach.
pub(super) fn reachable(profile: Profile, view: &GroundView<'_>) -> Profile {
    profile.clipped(view.head.tilt().and_then(|axis| axis.limits)).0
}

/// A UT2004 link, calibrated, with readings.
#[cfg(test)]
pub(super) fn hinge_pace() -> Pace {
    Pace {
        flowing: Some(StepLimit {
            tolerated_rad: 0.0012,
            tolerated_share: 0.1,
            lines_per_sigma: 22.0,
        }),
        law: Some(ServoLaw::Hinge { speed_rad_s: 0.17, gap_rad: 0.035 }),
        interval_s: 0.2,
        tolerance_rad: 0.001,
        unknown_settle_s: 1.5,
        obeyed_s: 0.06,
    }
}

#[cfg(test)]
mod tests {
    use super::super::testbed::head;
    use super::*;
    use crate::geometry::AngleSpan;
    use std::f64::consts::FRAC_PI_2;

    fn chosen(interest: &Interest) -> Offer {
        let head = head(Some(AngleSpan::new(-1.0, 1.0)), Some(0.17));
        let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: FRAC_PI_2 };
        choose(&view, &FanConfig::default(), interest, &hinge_pace(), (0.3, 0.0)).unwrap()
    }

    /// Unseen ground right before the robot alone.
    fn near() -> Interest {
        let mut interest = Interest::default();
        interest.add(0.55, 60.0);
        interest
    }

    #[test]
    fn near_ground_that_is_unseen_is_worth_the_steep_rows() {
        let offer = chosen(&near());
        assert!(offer.request.profile.name == "ground fan", "{}", offer.reason);
        // Down to the steepest row and up again over all of them, at 9.7°/s.
        assert!((8.0..16.0).contains(&offer.seconds), "{} s", offer.seconds);
    }

    #[test]
    fn where_only_far_ground_is_unseen_the_steep_rows_are_left_out() {
        let mut interest = Interest::default();
        (0..16).for_each(|ring| interest.add(4.0 + 0.25 * f64::from(ring), 2.0));
        let offer = chosen(&interest);
        assert!(offer.request.profile.name.starts_with("fan from"), "{}", offer.reason);
        let whole = chosen(&near());
        assert!(offer.seconds < 0.7 * whole.seconds, "{} {}", offer.seconds, whole.seconds);
        // Beyond seven metres a quarter of a degree is more than a ring's spacing.
        assert!((28.0..=32.0).contains(&offer.gain_m2), "{}", offer.reason);
        assert!(offer.reason.contains("the whole fan"), "{}", offer.reason);
    }

    #[test]
    fn sweeps_over_the_whole_height_compete_by_what_their_rows_show() {
        let head = head(Some(AngleSpan::new(-1.0, 1.0)), Some(0.17));
        let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: FRAC_PI_2 };
        let mut interest = Interest::default();
        (8..20).for_each(|ring| interest.add(0.25 * f64::from(ring), 1.0));
        let shown = |step| interest.shown_m2(&Profile::coarse(step), &view, 0.5);
        assert!((shown(0.25) - 12.0).abs() < 1e-9, "{}", shown(0.25));
        assert!(shown(2.0) > 4.0 && shown(2.0) < 10.0, "{}", shown(2.0));
        // With nothing left to see on the ground the walls decide, and what is quick shows them.
        let offer = chosen(&Interest::default());
        assert!(offer.seconds < chosen(&near()).seconds, "{}", offer.reason);
        assert!(offer.reason.contains("the whole fan 0.0 m²"), "{}", offer.reason);
    }

    #[test]
    fn offers_keep_to_the_reach_of_the_tilt_and_promise_no_more_than_they_show() {
        let mut interest = Interest::default();
        (2..30).for_each(|ring| interest.add(0.25 * f64::from(ring), 1.0));
        interest.require(0.9);
        interest.require(6.0);
        // Ground is seen from 2.4 m on in the first, and out to 3.2 m in the second.
        for (least, most) in [(-0.5, 0.2), (0.15, 1.0)] {
            let limits = AngleSpan::new(least, most);
            let head = head(Some(limits), Some(0.17));
            let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: FRAC_PI_2 };
            let config = FanConfig::default();
            let offer = choose(&view, &config, &interest, &hinge_pace(), (0.18, 0.0)).unwrap();
            let tilts = &offer.request.profile.tilts;
            assert!(tilts.iter().all(|tilt| limits.contains(tilt.radians())), "{tilts:?}");
            let seen = |tilt: f64| view.ground_ahead_m(tilt).unwrap_or(f64::INFINITY);
            let (near_m, far_m) = (seen(most), seen(least));
            let in_sight = (2..30).map(|ring| 0.25 * (f64::from(ring) + 0.5));
            let in_sight = in_sight.filter(|r| (near_m..=far_m).contains(r)).count() as f64;
            assert!(offer.gain_m2 <= in_sight, "{} of {in_sight} m²", offer.gain_m2);
            assert!(offer.gain_m2 > 0.7 * in_sight, "{} of {in_sight} m²", offer.gain_m2);
        }
    }

    #[test]
    fn a_suspected_edge_gets_fine_rows_whatever_else_is_chosen() {
        let mut interest = Interest::default();
        (0..16).for_each(|ring| interest.add(4.0 + 0.25 * f64::from(ring), 2.0));
        [1.2, 1.3, 1.4].into_iter().for_each(|d| interest.require(d));
        assert_eq!(interest.required_m.len(), 1);
        let offer = chosen(&interest);
        let head = head(Some(AngleSpan::new(-1.0, 1.0)), Some(0.17));
        let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: FRAC_PI_2 };
        let tilts = &offer.request.profile.tilts;
        let mut rings: Vec<f64> =
            tilts.iter().filter_map(|tilt| view.ground_ahead_m(tilt.radians())).collect();
        rings.sort_by(f64::total_cmp);
        let near: Vec<f64> = rings.into_iter().filter(|d| (1.05..1.6).contains(d)).collect();
        assert!(near.len() >= 4, "{near:?}");
        assert!(near.windows(2).all(|w| w[1] - w[0] < FINE_RING_M + 0.02), "{near:?}");
        assert!(offer.reason.contains("fine rows at 1.1 to 1.5 m"), "{}", offer.reason);
    }
}
