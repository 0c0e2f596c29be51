//! A sweep that ended with next to nothing because the tilt reaches less than was known is taken again
//! at once, within what it does reach.

use super::scan::Scan;
use super::{Acquisition, HeadAction, SweepRequest};
use crate::time::Arrival;
use serde::{Deserialize, Serialize};

/// What is to be taken again if it is in vain, and what came of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Repeat {
    request: Option<SweepRequest>,
    /// The scan in vain, with all that is to be said of it.
    before: Option<Box<Scan>>,
}

impl Repeat {
    /// Nothing yet of `request`; `None` where it is not to be repeated.
    pub(super) fn of(request: Option<SweepRequest>) -> Self {
        Self { request, before: None }
    }

    /// `scan` with the time and the remarks of the one before it.
    pub(super) fn joined(self, mut scan: Scan) -> Scan {
        if let Some(before) = self.before {
            scan.started = before.started;
            scan.budget.add(&before.budget);
            scan.repeats += before.repeats;
            scan.remarks.splice(0..0, before.remarks);
        }
        scan
    }
}

impl Acquisition {
    /// Takes a finished sweep with few rows out of `actions` and begins it again, if the tilt has just been
    /// turned back (`probed`) and an end of its reach is what left it so. The new end is known to be
    /// reached, so that it begins there; should the other end be nearer than told, too, the tilt meets
    /// that one in motion, with rows before it.
    pub(super) fn repeat_what_was_in_vain(
        &mut self,
        probed: bool,
        actions: &mut Vec<HeadAction>,
        now: Arrival,
    ) {
        let Some(at) = actions.iter().position(|a| matches!(a, HeadAction::Finished(_))) else {
            return;
        };
        let HeadAction::Finished(scan) = actions.remove(at) else { return };
        let mut repeat = std::mem::take(&mut self.repeat);
        let request = repeat.request.take().filter(|request| {
            let reach = self.control.reach();
            let (within, _) = request.profile.clone().clipped(reach.limits());
            probed && reach.stuck_rad().is_none() && 2 * scan.filed < within.len()
        });
        let mut scan = Box::new(repeat.joined(*scan));
        let Some(request) = request else {
            actions.insert(at, HeadAction::Finished(scan));
            return;
        };
        scan.remarks.push(format!("{} rows came of that: the sweep is begun anew", scan.filed));
        self.repeat = Repeat { request: None, before: Some(scan) };
        actions.extend(self.begin(request, now));
    }
}
