//! Infrared and plain rangers: one ray, or a fan of them.

use super::ranging::{RangeNoise, bearings_rad};
use super::{Carrier, Mounting};
use crate::protocol::Dialect;
use crate::protocol::message::sen::{RangeReading, RangeScanner};
use crate::sim::noise::Noise;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::scenario::NoiseSpec;
use crate::sim::spec::SensorSpec;
use crate::sim::surroundings::Surroundings;
use crate::sim::wire;
use crate::time::Stamp;
use nalgebra::{Point3, Vector3};

/// A ranger of one ray (`IR`, `Range`), clipped at both ends.
#[derive(Clone, Debug)]
pub(crate) struct Beam {
    pub(crate) mounting: Mounting,
    pub(crate) min_range_m: f64,
    pub(crate) max_range_m: f64,
    noise: RangeNoise,
}

impl Beam {
    pub(crate) fn new(
        spec: &SensorSpec,
        units: &[PanTilt],
        dialect: Dialect,
        noise: &NoiseSpec,
        source: Noise,
    ) -> Self {
        Self {
            mounting: Mounting::new(spec, units),
            min_range_m: spec.min_range_m.unwrap_or(0.2),
            max_range_m: spec.max_range_m.unwrap_or(1.5),
            noise: RangeNoise::new(noise, dialect, source),
        }
    }

    /// One reading, on the wire's grid.
    pub(crate) fn read(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
    ) -> RangeReading {
        let range_m = self.measure(carrier, surroundings, &Vector3::x());
        RangeReading { name: self.mounting.name.clone(), range_m: wire::truncate(range_m, 4) }
    }

    /// Distance along a ray of the sensor's frame.
    fn measure(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        ray: &Vector3<f64>,
    ) -> f64 {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let origin = Point3::from(world_from_sensor.translation.vector);
        let direction = world_from_sensor.rotation * ray;
        let seen = surroundings.cast(&origin, &direction, self.max_range_m);
        let noisy = self.noise.apply(seen.map_or(self.max_range_m, |seen| seen.range_m));
        noisy.clamp(self.min_range_m, self.max_range_m)
    }
}

/// An infrared scanner. Its beams are spread only where its yaw flag is set; as a server comes, all
/// of them look straight ahead.
#[derive(Clone, Debug)]
pub(crate) struct IrScanner {
    pub(crate) beam: Beam,
    pub(crate) fov_rad: f64,
    pub(crate) resolution_rad: f64,
    pub(crate) yaw: bool,
    decimals: i32,
    bearings: Vec<f64>,
}

/// The fan of the UDK server's configuration, in Unreal units of 1/65536 of a turn.
const FOV_UNITS: f64 = 32_751.0;
const RESOLUTION_UNITS: f64 = 907.0;

/// Half a unit, so that a configured fan is not cut to the unit below.
const HALF_UNIT: f64 = 0.5;

impl IrScanner {
    pub(crate) fn new(
        spec: &SensorSpec,
        units: &[PanTilt],
        dialect: Dialect,
        noise: &NoiseSpec,
        source: Noise,
    ) -> Self {
        let angle = |degrees: Option<f64>, units: f64| {
            degrees.map_or_else(|| wire::units_rad(units + HALF_UNIT), f64::to_radians)
        };
        let fov_rad = angle(spec.fov_deg, FOV_UNITS);
        let resolution_rad = angle(spec.resolution_deg, RESOLUTION_UNITS);
        let beams = (fov_rad / resolution_rad * (1.0 + 1e-9)).floor() as usize + 1;
        let mut bearings = bearings_rad(dialect, fov_rad, resolution_rad, beams);
        let mut beam = Beam::new(spec, units, dialect, noise, source);
        beam.max_range_m = spec.max_range_m.unwrap_or(10.0);
        let decimals = match dialect {
            Dialect::Ut2004 => 4,
            Dialect::Udk => 2,
        };
        // The server's loop ends before the left edge of the fan, not on it.
        if dialect == Dialect::Udk
            && bearings.last().is_some_and(|last| *last >= wire::units_rad(half_units(fov_rad)))
        {
            bearings.pop();
        }
        let yaw = spec.yaw.unwrap_or(false);
        Self { beam, fov_rad, resolution_rad, yaw, decimals, bearings }
    }

    /// Casts one line, stamped `time`.
    pub(crate) fn cast(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        time: Stamp,
    ) -> RangeScanner {
        let Self { beam, bearings, .. } = self;
        let mut ranges_m = Vec::with_capacity(bearings.len());
        for bearing in bearings.iter() {
            let (sin, cos) = if self.yaw { bearing.sin_cos() } else { (0.0, 1.0) };
            let range_m = beam.measure(carrier, surroundings, &Vector3::new(cos, sin, 0.0));
            ranges_m.push(wire::truncate(range_m, self.decimals));
        }
        RangeScanner {
            time: Some(time),
            name: beam.mounting.name.clone(),
            resolution_rad: Some(wire::angle(self.resolution_rad)),
            fov_rad: Some(wire::angle(self.fov_rad)),
            ranges_m,
            extra: Vec::new(),
        }
    }
}

/// Half of an angle in Unreal units, of which the angle has a whole number.
fn half_units(angle_rad: f64) -> f64 {
    wire::angle_units(angle_rad) / 2.0
}
