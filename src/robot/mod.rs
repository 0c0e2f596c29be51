//! The rig: mounts, limits and kinematics learned from the server, and wire values turned into project frames.
