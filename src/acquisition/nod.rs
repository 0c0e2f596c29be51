//! Nodding: a sweep taken while the robot drives on slowly, where that shows more per second than a
//! stop would.

use super::SweepRequest;
use super::policy::{Interest, Offer, Pace, WALLS_M2, choose as choose_standing, reachable};
use super::profile::{FanConfig, Profile};
use crate::robot::GroundView;
use serde::{Deserialize, Serialize};

/// What nodding costs and needs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodTerms {
    /// Speed without it, in m/s, above 0.
    pub full_mps: f64,
    /// Speed at which it may be done without a guard line, in m/s, above 0 and at most `full_mps`.
    pub slow_mps: f64,
    /// Path ahead over ground that was seen well, in metres.
    pub sure_m: f64,
    /// Where the guard line lies, from the robot's centre, in metres: nearer ground was seen by it.
    pub guard_m: f64,
    /// Time that a stop for a sweep costs besides the sweep, in seconds: braking, coming to rest, parking
    /// the head and gathering speed.
    pub stop_s: f64,
}

/// The nod, with its price: the time by which the robot arrives later.
pub(super) fn choose(
    view: &GroundView<'_>,
    config: &FanConfig,
    interest: &Interest,
    pace: &Pace,
    tilt_rad: f64,
    terms: &NodTerms,
) -> Result<Offer, String> {
    if let Some((near_m, far_m)) = interest.required_m.first() {
        return Err(format!("what lies {near_m:.1} to {far_m:.1} m ahead is looked at standing"));
    }
    let fan = FanConfig { nearest_m: config.nearest_m.max(terms.guard_m), ..config.clone() };
    // From the farthest ground to the guard line, where the head belongs afterwards.
    let mut profile = reachable(Profile::ground_fan(view, &fan), view);
    profile.tilts.sort();
    profile.name = "nod".to_owned();
    let Some(standing) = choose_standing(view, config, interest, pace, (tilt_rad, terms.stop_s))
    else {
        return Err("the laser cannot tilt".to_owned());
    };
    let nod_s = pace.seconds(&profile, tilt_rad);
    let way_m = terms.slow_mps * nod_s;
    if way_m > terms.sure_m {
        return Err(format!("{way_m:.1} m of the way must be known, {:.1} m are", terms.sure_m));
    }
    let cost_s = nod_s * (1.0 - terms.slow_mps / terms.full_mps);
    // Its rows are as good to drive on as those of the guard line, which is dead reckoning too; what it
    // cannot give is the walls that tell where the robot is.
    let gain_m2 = interest.shown_m2(&profile, view, config.ring_spacing_m);
    let rate = gain_m2 / cost_s.max(1e-3);
    let stop_s = standing.seconds + terms.stop_s;
    let stop_rate = (standing.gain_m2 + WALLS_M2) / stop_s;
    let told = format!(
        "nod: {gain_m2:.1} m² for {cost_s:.1} s; a stop {:.1} m² for {stop_s:.1} s",
        standing.gain_m2
    );
    if rate <= stop_rate || gain_m2 < WALLS_M2 {
        return Err(told);
    }
    Ok(Offer { request: SweepRequest::nodding(profile), seconds: nod_s, gain_m2, reason: told })
}

#[cfg(test)]
mod tests {
    use super::super::policy::hinge_pace;
    use super::super::testbed::head;
    use super::*;
    use crate::geometry::AngleSpan;
    use std::f64::consts::FRAC_PI_2;

    const TERMS: NodTerms =
        NodTerms { full_mps: 0.5, slow_mps: 0.15, sure_m: 3.0, guard_m: 1.2, stop_s: 4.0 };

    fn chosen(interest: &Interest, terms: &NodTerms) -> Result<Offer, String> {
        let head = head(Some(AngleSpan::new(-1.0, 1.0)), Some(0.17));
        let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: FRAC_PI_2 };
        choose(&view, &FanConfig::default(), interest, &hinge_pace(), 0.4, terms)
    }

    fn unseen(from_m: f64, to_m: f64, each_m2: f64) -> Interest {
        let mut interest = Interest::default();
        let rings = ((to_m - from_m) / 0.25) as u32;
        (0..rings).for_each(|ring| interest.add(from_m + 0.25 * f64::from(ring), each_m2));
        interest
    }

    #[test]
    fn far_ground_unseen_on_a_known_way_is_nodded_at_and_the_head_ends_at_the_guard_line() {
        let offer = chosen(&unseen(2.0, 6.0, 3.0), &TERMS).unwrap();
        let tilts = &offer.request.profile.tilts;
        assert!(tilts.windows(2).all(|pair| pair[0] < pair[1]), "{tilts:?}");
        assert!(offer.reason.contains("a stop"), "{}", offer.reason);
    }

    #[test]
    fn nothing_unseen_an_unknown_way_or_a_suspected_edge_forbid_it() {
        assert!(chosen(&unseen(2.0, 6.0, 0.01), &TERMS).unwrap_err().starts_with("nod:"));
        let short = NodTerms { sure_m: 0.4, ..TERMS };
        let why = chosen(&unseen(2.0, 6.0, 3.0), &short).unwrap_err();
        assert!(why.ends_with("0.4 m are"), "{why}");
        let mut edge = unseen(2.0, 6.0, 3.0);
        edge.require(1.5);
        assert!(chosen(&edge, &TERMS).unwrap_err().contains("looked at standing"));
    }
}
