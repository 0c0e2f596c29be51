//! The stand-in simulator: world, vehicle, sensors and the session that speaks the protocol.
