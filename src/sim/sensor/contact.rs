//! Bumpers and satellite positioning: the small ones.

use super::{Carrier, Mounting};
use crate::protocol::message::sen::{GeoCoordinate, Gps, TouchReading};
use crate::sim::pan_tilt::PanTilt;
use crate::sim::spec::SensorSpec;
use crate::sim::wire;

/// A bumper: touched when the body is pressed within its reach.
#[derive(Clone, Debug)]
pub(crate) struct Bumper {
    pub(crate) mounting: Mounting,
    pub(crate) diameter_m: f64,
}

impl Bumper {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        Self { mounting: Mounting::new(spec, units), diameter_m: spec.diameter_m.unwrap_or(0.1) }
    }

    pub(crate) fn read(&self, carrier: &Carrier<'_>) -> TouchReading {
        let centre = carrier.world_from_sensor(&self.mounting).translation.vector;
        let touched = carrier
            .state
            .body_touches
            .iter()
            .any(|touch| (touch.point.coords - centre).norm() <= self.diameter_m / 2.0);
        TouchReading { name: self.mounting.name.clone(), touched }
    }
}

/// A satellite receiver; under a roof it sees none.
#[derive(Clone, Debug)]
pub(crate) struct Receiver {
    pub(crate) mounting: Mounting,
    satellites: u32,
}

/// Satellites that a fix takes.
const FIX_TAKES: u32 = 4;

/// The map's origin in degrees north and west, and metres in a degree (protocol document 3.5).
const ORIGIN_DEG: [f64; 2] = [39.0 + 8.0273 / 60.0, 77.0 + 12.998 / 60.0];
const METRES_PER_DEG: [f64; 2] = [111_200.0, 71_670.0];

impl Receiver {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        Self { mounting: Mounting::new(spec, units), satellites: spec.satellites.unwrap_or(0) }
    }

    pub(crate) fn read(&self, carrier: &Carrier<'_>) -> Gps {
        let place = carrier.world_from_sensor(&self.mounting).translation.vector;
        let fix = self.satellites >= FIX_TAKES;
        let coordinate = |degrees: f64, hemisphere: char| {
            fix.then(|| GeoCoordinate {
                degrees: degrees.trunc() as i64,
                minutes: wire::truncate(degrees.fract() * 60.0, 4),
                hemisphere,
            })
        };
        Gps {
            time: None,
            name: self.mounting.name.clone(),
            latitude: coordinate(ORIGIN_DEG[0] + place.x / METRES_PER_DEG[0], 'N'),
            longitude: coordinate(ORIGIN_DEG[1] + place.y / METRES_PER_DEG[1], 'W'),
            fix: Some(i64::from(fix)),
            satellites: Some(i64::from(self.satellites)),
            extra: Vec::new(),
        }
    }
}

/// A camera: only its view is kept here, its pictures are drawn elsewhere.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    pub(crate) mounting: Mounting,
    pub(crate) default_fov_rad: f64,
    pub(crate) min_fov_rad: f64,
    pub(crate) max_fov_rad: f64,
    pub(crate) fov_rad: f64,
    pub(crate) size: [u32; 2],
}

impl Camera {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        let default_fov_rad = spec.fov_deg.unwrap_or(45.0).to_radians();
        Self {
            mounting: Mounting::new(spec, units),
            default_fov_rad,
            min_fov_rad: spec.min_fov_deg.unwrap_or(20.0).to_radians(),
            max_fov_rad: spec.max_fov_deg.unwrap_or(120.0).to_radians(),
            fov_rad: default_fov_rad,
            size: [spec.width.unwrap_or(320), spec.height.unwrap_or(240)],
        }
    }

    /// Sets the view; 0 resets it, other values are clamped.
    pub(crate) fn zoom(&mut self, fov_rad: f64) {
        self.fov_rad = if fov_rad == 0.0 {
            self.default_fov_rad
        } else {
            fov_rad.clamp(self.min_fov_rad, self.max_fov_rad)
        };
    }
}

/// Drops radio tags.
#[derive(Clone, Debug)]
pub(crate) struct Releaser {
    pub(crate) mounting: Mounting,
    pub(crate) left: u32,
}

impl Releaser {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        Self { mounting: Mounting::new(spec, units), left: spec.tags.unwrap_or(10) }
    }
}
