//! Laser scanners and sonars.

use super::{Carrier, Mounting};
use crate::protocol::Dialect;
use crate::protocol::message::sen::RangeScanner;
use crate::sim::noise::Noise;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::scenario::NoiseSpec;
use crate::sim::spec::SensorSpec;
use crate::sim::surroundings::Surroundings;
use crate::sim::wire;
use crate::time::Stamp;
use nalgebra::{Isometry3, Point3, Rotation3, Vector3};
use std::f64::consts::TAU;

/// Errors of measured distances.
#[derive(Clone, Debug)]
pub(super) struct RangeNoise {
    relative: f64,
    sigma_m: f64,
    source: Noise,
}

impl RangeNoise {
    pub(super) fn new(spec: &NoiseSpec, dialect: Dialect, source: Noise) -> Self {
        let by_dialect = match dialect {
            Dialect::Ut2004 => 0.001,
            Dialect::Udk => 0.0,
        };
        Self {
            relative: spec.range_relative.unwrap_or(by_dialect),
            sigma_m: spec.range_sigma_m,
            source,
        }
    }

    pub(super) fn apply(&mut self, range_m: f64) -> f64 {
        let mut noisy = range_m;
        if self.relative > 0.0 {
            noisy *= 1.0 + self.source.symmetric(self.relative);
        }
        if self.sigma_m > 0.0 {
            noisy += self.sigma_m * self.source.normal();
        }
        noisy.max(0.0)
    }
}

/// A laser scanner: beams in its x-y plane, the first one rightmost.
#[derive(Clone, Debug)]
pub(crate) struct Scanner {
    pub(crate) mounting: Mounting,
    pub(crate) min_range_m: f64,
    pub(crate) max_range_m: f64,
    pub(crate) fov_rad: f64,
    pub(crate) resolution_rad: f64,
    dialect: Dialect,
    noise: RangeNoise,
    bearings: Vec<f64>,
}

impl Scanner {
    pub(crate) fn new(
        spec: &SensorSpec,
        units: &[PanTilt],
        dialect: Dialect,
        noise: &NoiseSpec,
        source: Noise,
    ) -> Self {
        let fov_rad = spec.fov_deg.unwrap_or(180.0).to_radians();
        let resolution_rad = spec.resolution_deg.unwrap_or(1.0).to_radians();
        Self {
            mounting: Mounting::new(spec, units),
            min_range_m: spec.min_range_m.unwrap_or(0.1),
            max_range_m: spec.max_range_m.unwrap_or(20.0),
            fov_rad,
            resolution_rad,
            dialect,
            noise: RangeNoise::new(noise, dialect, source),
            bearings: bearings_rad(dialect, fov_rad, resolution_rad, spec.beams()),
        }
    }

    /// Casts one line, stamped `time`.
    pub(crate) fn cast(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        time: Stamp,
    ) -> RangeScanner {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let origin = Point3::from(world_from_sensor.translation.vector);
        let bearings = std::mem::take(&mut self.bearings);
        let ranges_m = bearings
            .iter()
            .map(|bearing| {
                let (sin, cos) = bearing.sin_cos();
                let direction = world_from_sensor.rotation * Vector3::new(cos, sin, 0.0);
                let seen = surroundings.cast(&origin, &direction, self.max_range_m);
                self.printed(seen.map(|seen| seen.range_m), &origin)
            })
            .collect();
        self.bearings = bearings;
        RangeScanner {
            time: Some(time),
            name: self.mounting.name.clone(),
            resolution_rad: Some(wire::angle(self.resolution_rad)),
            fov_rad: Some(wire::angle(self.fov_rad)),
            ranges_m,
            extra: Vec::new(),
        }
    }

    /// A range as the dialect's scanner prints it.
    ///
    /// UDK's scanners compute the range from a hit point that the engine leaves at the world's
    /// origin when nothing is hit.
    fn printed(&mut self, range_m: Option<f64>, origin: &Point3<f64>) -> f64 {
        match self.dialect {
            Dialect::Ut2004 => {
                let noisy = self.noise.apply(range_m.unwrap_or(self.max_range_m));
                wire::truncate(noisy.min(self.max_range_m), 4)
            }
            Dialect::Udk => {
                let range = range_m.unwrap_or_else(|| origin.coords.norm());
                wire::truncate(self.noise.apply(range), 2)
            }
        }
    }
}

/// Bearings of all beams of a fan in the core's sense, left positive, from right to left.
pub(super) fn bearings_rad(
    dialect: Dialect,
    fov_rad: f64,
    resolution_rad: f64,
    beams: usize,
) -> Vec<f64> {
    match dialect {
        Dialect::Ut2004 => {
            let steps = (beams - 1).max(1) as f64;
            (0..beams).map(|beam| fov_rad * (beam as f64 / steps - 0.5)).collect()
        }
        Dialect::Udk => {
            // Whole Unreal units: from half the field of view down by the resolution.
            let [fov, step] = [fov_rad, resolution_rad].map(|a| (a / TAU * 65_536.0).trunc());
            let first = (fov / 2.0).floor();
            let count = ((first + fov / 2.0) / step).floor() as usize + 1;
            (0..count).map(|beam| wire::units_rad(beam as f64 * step - first)).collect()
        }
    }
}

/// A sonar: the nearest echo within a cone.
#[derive(Clone, Debug)]
pub(crate) struct Sonar {
    pub(crate) mounting: Mounting,
    pub(crate) min_range_m: f64,
    pub(crate) max_range_m: f64,
    pub(crate) beam_rad: f64,
    dialect: Dialect,
    noise: RangeNoise,
    rays: Vec<Vector3<f64>>,
}

/// Rays of a UT2004 sonar.
const UT2004_RAYS: usize = 9;

/// Rings of rays about a UDK sonar's axis, and rays in a ring.
pub(crate) const UDK_CONES: usize = 10;
pub(crate) const UDK_TRACES: usize = 16;

/// UDK ignores echoes farther than this off the surface's normal, in radians.
pub(crate) const UDK_MAX_INCIDENCE_RAD: f64 = 0.174_55;

impl Sonar {
    pub(crate) fn new(
        spec: &SensorSpec,
        units: &[PanTilt],
        dialect: Dialect,
        noise: &NoiseSpec,
        source: Noise,
    ) -> Self {
        let beam_rad = spec.beam_deg.unwrap_or(20.0).to_radians();
        let rays = match dialect {
            Dialect::Ut2004 => fan(beam_rad),
            Dialect::Udk => cone(beam_rad),
        };
        Self {
            mounting: Mounting::new(spec, units),
            min_range_m: spec.min_range_m.unwrap_or(0.1),
            max_range_m: spec.max_range_m.unwrap_or(5.0),
            beam_rad,
            dialect,
            noise: RangeNoise::new(noise, dialect, source),
            rays,
        }
    }

    /// One reading, on the wire's grid.
    pub(crate) fn measure(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
    ) -> f64 {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let nearest = self.nearest_m(&world_from_sensor, surroundings);
        let noisy = self.noise.apply(nearest.unwrap_or(self.max_range_m));
        wire::truncate(noisy.clamp(self.min_range_m, self.max_range_m), 4)
    }

    fn nearest_m(
        &self,
        world_from_sensor: &Isometry3<f64>,
        surroundings: &Surroundings<'_>,
    ) -> Option<f64> {
        let origin = Point3::from(world_from_sensor.translation.vector);
        let mut nearest: Option<f64> = None;
        for ray in &self.rays {
            let direction = world_from_sensor.rotation * ray;
            let reach = nearest.unwrap_or(self.max_range_m);
            let Some(seen) = surroundings.cast(&origin, &direction, reach) else { continue };
            let echoes = match self.dialect {
                Dialect::Ut2004 => true,
                Dialect::Udk => -seen.normal.dot(&direction) >= UDK_MAX_INCIDENCE_RAD.cos(),
            };
            if echoes {
                nearest = Some(seen.range_m);
            }
        }
        nearest
    }
}

/// Rays of a UT2004 sonar: in one plane, because a recorded robot 0.15 m above the ground reads
/// 4.55 m where a cone of 20° would meet the floor at 0.86 m.
fn fan(beam_rad: f64) -> Vec<Vector3<f64>> {
    (0..UT2004_RAYS)
        .map(|ray| {
            let off = beam_rad * (ray as f64 / (UT2004_RAYS - 1) as f64 - 0.5);
            Vector3::new(off.cos(), off.sin(), 0.0)
        })
        .collect()
}

/// Rays of a UDK sonar: the axis, and rings of rays about it.
fn cone(beam_rad: f64) -> Vec<Vector3<f64>> {
    let mut rays = vec![Vector3::x()];
    for ring in 1..=UDK_CONES {
        let off = beam_rad / 2.0 * ring as f64 / UDK_CONES as f64;
        rays.extend((0..UDK_TRACES).map(|spoke| {
            let angle = TAU * spoke as f64 / UDK_TRACES as f64;
            let about = Rotation3::from_axis_angle(&Vector3::x_axis(), angle);
            about * Vector3::new(off.cos(), off.sin(), 0.0)
        }));
    }
    rays
}
