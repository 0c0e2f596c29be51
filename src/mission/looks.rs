//! What a sweep from where the robot stands could still show, and which sweep to take for it.

use super::config::{AgentConfig, FineSweep, LookPolicy};
use super::running::Running;
use crate::acquisition::{Interest, Offer, Profile, SweepRequest};
use crate::mapping::Mode as MapperMode;
use crate::navigation::Pose2;
use crate::terrain::CellClass;
use nalgebra::Point2;

/// Bearings between the rays along which unseen ground is looked for, in radians.
const BEARING_STEP_RAD: f64 = 0.05;
/// Steps along a ray in metres: one cell of the finest grid in use.
const STEP_M: f64 = 0.1;
/// Suspected edges and unknown ground in the way of the robot up to this far get fine rows: it may
/// fall there, or someone may lie there. What lies farther away is looked at again from nearer by.
const WAY_WITHIN_M: f64 = 2.5;
/// Half the width of that way in metres: the robot's own and a person's shoulder.
const WAY_HALF_WIDTH_M: f64 = 0.5;
/// What is supposed of the time between two looks before a mission has shown it: seconds in all, and how
/// many times that is.
const USUALLY_BETWEEN: (f64, f64) = (30.0, 3.0);

impl Running {
    /// The ground in sight that was not seen well enough.
    pub(super) fn interest(&self) -> Interest {
        let mut interest = Interest::default();
        let Some(acquisition) = &self.acquisition else { return interest };
        let reach_m = acquisition.config().fan.reach_m;
        let blind_m = self.rig.visibility().and_then(|sight| sight.nearest_from_centre_m);
        let pose = self.pose2();
        let way = self.way_ahead(&pose);
        let rays = (std::f64::consts::PI / BEARING_STEP_RAD) as i32 / 2;
        for bearing in (-rays..=rays).map(|i| f64::from(i) * BEARING_STEP_RAD) {
            let (sin, cos) = (pose.yaw_rad + bearing).sin_cos();
            let mut r = blind_m.unwrap_or(0.0);
            while r < reach_m {
                let at = Point2::new(pose.x_m + r * cos, pose.y_m + r * sin);
                let cell = self.grid.cell_of(at.x, at.y);
                let seen = self.grid.get(cell);
                let unseen = match seen.class {
                    CellClass::Unknown | CellClass::Suspect => true,
                    class => class.is_drivable() && !seen.sure,
                };
                if unseen {
                    interest.add(r, r * BEARING_STEP_RAD * STEP_M);
                }
                let hidden = matches!(seen.class, CellClass::Suspect | CellClass::Unknown);
                let in_the_way = |way: &Point2<f64>| {
                    nalgebra::distance_squared(way, &at) < WAY_HALF_WIDTH_M.powi(2)
                };
                if hidden && r < WAY_WITHIN_M && way.iter().any(in_the_way) {
                    interest.require(r);
                }
                if seen.opaque {
                    break;
                }
                r += STEP_M;
            }
        }
        interest
    }

    /// Where the robot may drive next: along what is left of its path, and straight ahead, whither the next
    /// path leads from its end or from where it is blocked.
    fn way_ahead(&self, pose: &Pose2) -> Vec<Point2<f64>> {
        let steps = (WAY_WITHIN_M / STEP_M) as u32;
        let ahead = (1..=steps).map(|step| pose.driven(STEP_M * f64::from(step), 0.0).point());
        self.pilot.way_ahead(pose, WAY_WITHIN_M, STEP_M).into_iter().chain(ahead).collect()
    }

    /// Seconds that pass from the end of one sweep to the beginning of the next, as it was so far.
    fn between_looks_s(&self) -> f64 {
        let split = self.ledger.split;
        let between_s = split.think_s + split.drive_s + split.turn_s + split.recover_s;
        let standing = self.ledger.sweeps.iter().filter(|sweep| sweep.driven_m.is_none()).count();
        (USUALLY_BETWEEN.0 + between_s) / (USUALLY_BETWEEN.1 + standing as f64)
    }

    /// The sweep that shows most per second from here, and why.
    pub(super) fn best_look(&self, config: &AgentConfig) -> Option<Offer> {
        let view = self.rig.ground_view()?;
        let flowing = config.mission.flowing_sweeps;
        let acquisition = self.acquisition.as_ref()?;
        let interest = self.interest();
        let offer = acquisition.choose(&view, &interest, flowing, self.between_looks_s())?;
        let mut request = match config.mission.looks {
            LookPolicy::Auto => return Some(offer),
            LookPolicy::Full => self.full_sweep(config)?,
            LookPolicy::Coarse => self.taken(Profile::coarse(2.0), config)?,
            LookPolicy::Fan => self.fan(config)?,
        };
        // What must be seen finely is, whatever the settings say: rows that are missing are added.
        let profile = request.profile.clone();
        let (profile, added) = acquisition.with_required(profile, &view, &interest);
        request.profile = profile;
        let mut reason = format!("{}, as the settings say", request.profile.name);
        if added > 0 {
            reason += &format!("; {added} fine rows added for what lies in the way");
        }
        let seconds = acquisition.seconds_for(&request.profile, flowing);
        Some(Offer { request, seconds, reason, ..offer })
    }

    /// The full sweep with which a mission begins, if it begins with one.
    pub(super) fn first_sweep(&self, config: &AgentConfig) -> Option<SweepRequest> {
        config.mission.fine_sweep_at_start.then(|| self.full_sweep(config))?
    }

    /// A profile as exploration takes it: in motion where the settings allow that.
    pub(super) fn taken(&self, profile: Profile, config: &AgentConfig) -> Option<SweepRequest> {
        let acquisition = self.acquisition.as_ref()?;
        Some(match config.mission.flowing_sweeps {
            true => SweepRequest::flowing(profile),
            false => SweepRequest::coarse(profile, acquisition.config()),
        })
    }

    fn full_sweep(&self, config: &AgentConfig) -> Option<SweepRequest> {
        let acquisition = self.acquisition.as_ref()?;
        let by_paper = config.belief.mapper.mode == MapperMode::Mip;
        Some(match config.mission.fine_sweep {
            FineSweep::Continuous => SweepRequest::continuous(),
            FineSweep::Model => SweepRequest::model(),
            FineSweep::Auto if config.mission.flowing_sweeps && !by_paper => SweepRequest::model(),
            FineSweep::Auto | FineSweep::Paper => SweepRequest::paper(acquisition.config()),
        })
    }
}
