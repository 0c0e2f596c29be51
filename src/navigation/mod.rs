//! From a goal to wheel speeds: planner, follower, speed rules, stuck detection.
