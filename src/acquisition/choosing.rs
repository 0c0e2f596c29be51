//! What the acquisition itself knows of the sweeps that could be taken: how fast its head is by now, and
//! what that makes of them.

use super::policy::{Interest, Offer, Pace};
use super::profile::Profile;
use super::{Acquisition, NodTerms, nod, policy};
use crate::robot::GroundView;

/// A sweep that is meant to be taken in motion takes no longer than this at rest, in seconds: rows are
/// left out before it keeps the robot standing for minutes.
const LONGEST_AT_REST_S: f64 = 90.0;

impl Acquisition {
    /// The sweep that shows most of `interest` per second, in motion if `flowing`, where `between_s`
    /// seconds pass from one sweep to the next; `None` for a laser that cannot tilt.
    pub fn choose(
        &self,
        view: &GroundView<'_>,
        interest: &Interest,
        flowing: bool,
        between_s: f64,
    ) -> Option<Offer> {
        let pace = Pace::of(&self.control, &self.config, flowing && self.may_flow());
        let tilt_rad = self.control.tilt.target_rad().unwrap_or(0.0);
        policy::choose(view, &self.config.fan, interest, &pace, (tilt_rad, between_s))
    }

    /// `profile` with the fine rows that `interest` requires, and how many had to be added.
    pub fn with_required(
        &self,
        profile: Profile,
        view: &GroundView<'_>,
        interest: &Interest,
    ) -> (Profile, usize) {
        let before = profile.len();
        let profile = policy::with_fine_rows(profile, view, interest);
        let added = profile.len().saturating_sub(before);
        (profile, added)
    }

    /// The sweep to be taken while the robot drives on, if that is worth more than stopping for one.
    ///
    /// # Errors
    ///
    /// Why none should be, in plain words.
    pub fn choose_nod(
        &self,
        view: &GroundView<'_>,
        interest: &Interest,
        terms: &NodTerms,
    ) -> Result<Offer, String> {
        if !self.may_flow() {
            return Err("the tilt's law is not known, or when it obeys".to_owned());
        }
        let latest = self.control.clock().latest();
        if !latest.is_some_and(|latest| self.control.reads_at(latest)) {
            return Err("the tilt sends no readings that would show it stuck on the way".to_owned());
        }
        let pace = Pace::of(&self.control, &self.config, true);
        let tilt_rad = self.control.tilt.target_rad().unwrap_or(0.0);
        nod::choose(view, &self.config.fan, interest, &pace, tilt_rad, terms)
    }

    /// How long a sweep over `profile` should take from where the tilt is, in seconds.
    pub fn seconds_for(&self, profile: &Profile, flowing: bool) -> f64 {
        let tilt_rad = self.control.tilt.target_rad().unwrap_or(0.0);
        let profile = profile.clone().from_nearer_end(tilt_rad);
        let flowing = flowing && self.may_flow();
        Pace::of(&self.control, &self.config, flowing).seconds(&profile, tilt_rad)
    }

    /// Whether it is known where the tilt is in motion.
    pub(super) fn may_flow(&self) -> bool {
        self.is_calibrated() && self.control.sure_until().is_none()
    }

    /// The rows of `profile` that can be taken at rest in a reasonable time, evenly spread, and what to
    /// say of it.
    pub(super) fn thinned(&self, profile: Profile) -> (Profile, Option<String>) {
        let one_of = |every: usize| {
            let tilts = profile.tilts.iter().step_by(every).copied().collect();
            Profile { name: profile.name.clone(), tilts }
        };
        let seconds = |profile: &Profile| self.seconds_for(profile, false);
        let is_short = |&every: &usize| seconds(&one_of(every)) <= LONGEST_AT_REST_S;
        let every = (1..profile.len()).find(is_short).unwrap_or(1);
        if every == 1 {
            return (profile, None);
        }
        let thinned = one_of(every);
        let row_s = seconds(&thinned) / thinned.len() as f64;
        let text = format!(
            "the tilt has to rest at each row, for {row_s:.1} s: one of {every} rows is taken"
        );
        (thinned, Some(text))
    }
}
