//! The mission as a whole, in lockstep with the stand-in.

use crate::replay::{record, scenario};

#[test]
fn the_place_told_at_the_end_is_one_that_a_sweep_corrected() {
    for end_s in [100.0, 107.0, 115.0] {
        let (agent, _) = record(&scenario(3, end_s));
        let belief = agent.running().unwrap().belief();
        assert!(belief.path_m() > 0.3, "{end_s}: the robot hardly moved");
        assert!(belief.leg_m() < 0.05, "{end_s}: {} m since the last sweep", belief.leg_m());
    }
}
