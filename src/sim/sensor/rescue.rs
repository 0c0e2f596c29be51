//! Sensors of the rescue task (UT2004): victims and radio tags.

use super::{Carrier, Mounting};
use crate::protocol::message::sen::{Rfid, RfidTag, VictSensor, VictimPart};
use crate::sim::noise::Noise;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::scenario::NoiseSpec;
use crate::sim::spec::SensorSpec;
use crate::sim::surroundings::Surroundings;
use crate::sim::victim::BodyPart;
use crate::sim::wire;
use crate::sim::world::{ObjectKind, Tag};
use crate::time::Stamp;
use nalgebra::{Isometry3, Point3, Vector3};

/// The grid of rays is scanned in this many interleaved passes, one in each sensor cycle.
const PASSES: usize = 4;

/// Angle between the rays of the grid in degrees.
const GRID_DEG: f64 = 4.0;

/// What a pass has found: whose part it is, which part, and where in the sensor's wire frame.
type Found = (usize, BodyPart, [f64; 3]);

/// Detects body parts, and false alarms that it takes for such.
#[derive(Clone, Debug)]
pub(crate) struct VictimSensor {
    pub(crate) mounting: Mounting,
    pub(crate) max_range_m: f64,
    pub(crate) fov_rad: f64,
    sigma: f64,
    source: Noise,
    rays: Vec<Vector3<f64>>,
    cycle: usize,
    found: Vec<Found>,
}

impl VictimSensor {
    pub(crate) fn new(
        spec: &SensorSpec,
        units: &[PanTilt],
        noise: &NoiseSpec,
        source: Noise,
    ) -> Self {
        let fov_deg = spec.fov_deg.unwrap_or(40.0);
        let half = (fov_deg / 2.0 / GRID_DEG).floor() as i64;
        let rays = (-half..=half)
            .flat_map(|row| {
                (-half..=half).map(move |column| {
                    let [yaw, pitch] =
                        [column, row].map(|step| (step as f64 * GRID_DEG).to_radians());
                    Vector3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin())
                })
            })
            .collect();
        Self {
            mounting: Mounting::new(spec, units),
            max_range_m: spec.max_range_m.unwrap_or(6.0),
            fov_rad: fov_deg.to_radians(),
            sigma: noise.victim,
            source,
            rays,
            cycle: 0,
            found: Vec::new(),
        }
    }

    /// One sensor cycle: a pass over a quarter of the rays, and every fourth time a line.
    pub(crate) fn cycle(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        time: Stamp,
    ) -> Option<VictSensor> {
        self.pass(&carrier.world_from_sensor(&self.mounting), surroundings);
        self.cycle += 1;
        if self.cycle < PASSES {
            return None;
        }
        self.cycle = 0;
        let parts: Vec<VictimPart> = std::mem::take(&mut self.found)
            .into_iter()
            .map(|(_, part, location)| VictimPart {
                part: part.name().to_owned(),
                location: location.map(|value| wire::round(value, 2)),
            })
            .collect();
        Some(VictSensor {
            time: Some(time),
            name: self.mounting.name.clone(),
            status: parts.is_empty().then(|| "NoVictims".to_owned()),
            parts,
            extra: Vec::new(),
        })
    }

    fn pass(&mut self, world_from_sensor: &Isometry3<f64>, surroundings: &Surroundings<'_>) {
        let origin = Point3::from(world_from_sensor.translation.vector);
        for ray in (self.cycle..self.rays.len()).step_by(PASSES) {
            let direction = world_from_sensor.rotation * self.rays[ray];
            let seen = surroundings.cast(&origin, &direction, self.max_range_m);
            let reach = seen.map_or(self.max_range_m, |seen| seen.range_m);
            if let Some((alarm, part, range)) =
                nearest_alarm(surroundings, &origin, &direction, reach)
            {
                // Near alarms are suppressed as a rule: the error grows with the distance.
                let error = self.error(range);
                if error.norm() > self.sigma * self.max_range_m / 3.0 {
                    // Victims and alarms are numbered from two ends.
                    self.note(usize::MAX - alarm, part, ray, range, &error);
                }
                continue;
            }
            let kind = seen.and_then(|seen| Some((seen.range_m, seen.object?)));
            let Some((range, object)) = kind else { continue };
            if let ObjectKind::VictimPart { victim, part } = surroundings.world.object(object).kind
            {
                let error = self.error(range);
                self.note(victim, part, ray, range, &error);
            }
        }
    }

    fn error(&mut self, range_m: f64) -> Vector3<f64> {
        let scale = range_m * self.sigma;
        Vector3::new(self.source.normal(), self.source.normal(), self.source.normal()) * scale
    }

    /// Keeps the first sight of each part of each body.
    fn note(
        &mut self,
        owner: usize,
        part: BodyPart,
        ray: usize,
        range_m: f64,
        error: &Vector3<f64>,
    ) {
        if self.found.iter().all(|(other, known, _)| (*other, *known) != (owner, part)) {
            let location = wire::vector(&(self.rays[ray] * range_m + error));
            self.found.push((owner, part, location));
        }
    }
}

/// The nearest false alarm on a ray, its part and its distance.
fn nearest_alarm(
    surroundings: &Surroundings<'_>,
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
    reach_m: f64,
) -> Option<(usize, BodyPart, f64)> {
    surroundings
        .world
        .false_alarms()
        .iter()
        .enumerate()
        .filter_map(|(number, alarm)| {
            let sphere = crate::sim::solid::Solid::Sphere(alarm.radius_m);
            let local = origin - alarm.centre.coords;
            let (range, _) = sphere.cast(&local, direction, reach_m)?;
            Some((number, alarm.part, range))
        })
        .min_by(|a, b| a.2.total_cmp(&b.2))
}

/// The radio tags of a session, whose memories clients write and whose number grows.
#[derive(Clone, Debug, Default)]
pub(crate) struct TagMemory {
    tags: Vec<Tag>,
}

impl TagMemory {
    pub(crate) fn new(tags: &[Tag]) -> Self {
        Self { tags: tags.to_vec() }
    }

    /// Tags within `reach_m` of a point, in the order in which they came to be.
    fn near(&self, point: &Point3<f64>, reach_m: f64) -> impl Iterator<Item = &Tag> {
        let point = *point;
        self.tags.iter().filter(move |tag| (tag.position - point).norm() <= reach_m)
    }

    /// Drops a new tag at a point; false if the world is full of them.
    pub(crate) fn release(&mut self, position: Point3<f64>) -> bool {
        const MOST_TAGS: usize = 1024;
        if self.tags.len() >= MOST_TAGS {
            return false;
        }
        let id = 1 + self.tags.iter().map(|tag| tag.id).max().unwrap_or(0).max(0);
        self.tags.push(Tag { id, position, memory: String::new() });
        true
    }
}

/// Reads radio tags nearby.
#[derive(Clone, Debug)]
pub(crate) struct TagReader {
    pub(crate) mounting: Mounting,
    max_range_m: f64,
    interval_s: Option<f64>,
    locations: bool,
    memories: bool,
    reported: Vec<i64>,
    reported_at: Option<Stamp>,
}

impl TagReader {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        Self {
            mounting: Mounting::new(spec, units),
            max_range_m: spec.max_range_m.unwrap_or(6.0),
            interval_s: spec.interval_s,
            locations: spec.locations.unwrap_or(true),
            memories: spec.always_read_memory.unwrap_or(false),
            reported: Vec::new(),
            reported_at: None,
        }
    }

    /// A line when the tags in range are others than before, or its interval has passed.
    ///
    /// A real recording shows tags in its first burst and never again while the robot hardly moves.
    pub(crate) fn cycle(
        &mut self,
        carrier: &Carrier<'_>,
        memory: &TagMemory,
        time: Stamp,
    ) -> Option<Rfid> {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let centre = Point3::from(world_from_sensor.translation.vector);
        let near: Vec<&Tag> = memory.near(&centre, self.max_range_m).collect();
        let ids: Vec<i64> = near.iter().map(|tag| tag.id).collect();
        let due = self
            .interval_s
            .zip(self.reported_at)
            .is_some_and(|(interval, at)| (time - at).seconds() >= interval - 1e-6);
        let news = ids != self.reported || due;
        self.reported = ids;
        if near.is_empty() || !news {
            return None;
        }
        self.reported_at = Some(time);
        let tags = near
            .into_iter()
            .map(|tag| RfidTag {
                id: tag.id.to_string(),
                location: self.locations.then(|| {
                    let local = world_from_sensor.inverse_transform_point(&tag.position);
                    wire::point(&local).map(|value| wire::round(value, 2))
                }),
                memory: self.memories.then(|| tag.memory.clone()),
            })
            .collect();
        Some(Rfid {
            time: Some(time),
            type_name: "RFID".to_owned(),
            name: self.mounting.name.clone(),
            tags,
            extra: Vec::new(),
        })
    }

    /// The memory of a tag in range.
    pub(crate) fn read_memory(
        &self,
        carrier: &Carrier<'_>,
        memory: &TagMemory,
        id: i64,
    ) -> Option<String> {
        let centre = Point3::from(carrier.world_from_sensor(&self.mounting).translation.vector);
        memory
            .near(&centre, self.max_range_m)
            .find(|tag| tag.id == id)
            .map(|tag| tag.memory.clone())
    }

    /// Writes the memory of a tag in range; tells whether there was one.
    pub(crate) fn write_memory(
        &self,
        carrier: &Carrier<'_>,
        memory: &mut TagMemory,
        id: i64,
        text: &str,
    ) -> bool {
        let centre = Point3::from(carrier.world_from_sensor(&self.mounting).translation.vector);
        let reach = self.max_range_m;
        let tag = memory
            .tags
            .iter_mut()
            .find(|tag| tag.id == id && (tag.position - centre).norm() <= reach);
        if let Some(tag) = tag {
            text.clone_into(&mut tag.memory);
            true
        } else {
            false
        }
    }
}
