//! The depth camera of UDK servers: an image in strips, sent when told to.

use super::{Carrier, Mounting};
use crate::protocol::message::sen::RangeImager;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::spec::SensorSpec;
use crate::sim::surroundings::Surroundings;
use crate::sim::wire;
use crate::time::Stamp;
use nalgebra::{Point3, Vector3};

/// Strips of a whole image.
const STRIPS: u32 = 20;

/// Opening of a Kinect from left to right and from top to bottom, in degrees: 1.0122 and 0.7853 rad.
const KINECT_FOV_DEG: [f64; 2] = [58.0, 45.0];

/// A camera that measures depths along its optical axis.
#[derive(Clone, Debug)]
pub(crate) struct DepthCamera {
    pub(crate) mounting: Mounting,
    max_range_m: f64,
    fov_rad: f64,
    size: [u32; 2],
    /// The strip to be sent next, while an image is being sent.
    next: Option<u32>,
}

impl DepthCamera {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        Self {
            mounting: Mounting::new(spec, units),
            max_range_m: spec.max_range_m.unwrap_or(10.0),
            fov_rad: spec.fov_deg.unwrap_or(KINECT_FOV_DEG[0]).to_radians(),
            size: [spec.width.unwrap_or(320), spec.height.unwrap_or(240)],
            next: None,
        }
    }

    /// Begins an image, from its first strip on.
    pub(crate) fn start(&mut self) {
        self.next = Some(0);
    }

    /// One line: the head alone while idle, else the next strip.
    pub(crate) fn read(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        time: Stamp,
    ) -> RangeImager {
        let strip = self.next;
        self.next = strip.map(|strip| strip + 1).filter(|next| *next < STRIPS);
        RangeImager {
            time: Some(time),
            name: self.mounting.name.clone(),
            resolution: self.size.map(f64::from).to_vec(),
            fov_rad: self.openings_rad().map(wire::angle).to_vec(),
            frames: Some(strip.map_or(0, |_| i64::from(STRIPS))),
            frame: Some(strip.map_or(0, i64::from)),
            ranges_m: strip.map(|strip| self.depths(strip, carrier, surroundings)),
            extra: Vec::new(),
        }
    }

    /// Openings from left to right and from top to bottom, in a Kinect's proportion.
    fn openings_rad(&self) -> [f64; 2] {
        let [across, down] = KINECT_FOV_DEG;
        [self.fov_rad, self.fov_rad * down / across]
    }

    /// Depths of a strip: rows from the top, columns from the left.
    fn depths(
        &self,
        strip: u32,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
    ) -> Vec<f64> {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let origin = Point3::from(world_from_sensor.translation.vector);
        let [width, height] = self.size;
        let rows = height / STRIPS;
        // Distance of the picture plane, in columns and in rows.
        let [across, down] = self.openings_rad().map(|opening| (opening / 2.0).tan());
        let focal = f64::from(width) / 2.0 / across;
        let per_row = f64::from(height) / 2.0 / down / focal;
        let mut depths = Vec::with_capacity((rows * width) as usize);
        for row in strip * rows..(strip + 1) * rows {
            let up = (f64::from(height) / 2.0 - f64::from(row) - 0.5) / per_row;
            for column in 0..width {
                let left = f64::from(width) / 2.0 - f64::from(column) - 0.5;
                let ray = Vector3::new(focal, left, up).normalize();
                let direction = world_from_sensor.rotation * ray;
                let reach = self.max_range_m / ray.x;
                let seen = surroundings.cast(&origin, &direction, reach);
                let depth = seen.map_or(self.max_range_m, |seen| seen.range_m * ray.x);
                depths.push(wire::truncate(depth, 2));
            }
        }
        depths
    }
}
