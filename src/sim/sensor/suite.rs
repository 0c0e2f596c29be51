//! All sensors of a robot, and the order and time in which they report.

use super::contact::{Bumper, Camera, Receiver, Releaser};
use super::{
    Beam, Carrier, DepthCamera, Ears, Encoder, Gauge, Ins, IrScanner, MotionSensor, Mounting,
    ObjectSensor, Odometry, Scanner, Sonar, Tachometer, TagMemory, TagReader, VictimSensor,
    WorldPose,
};
use crate::protocol::message::sen::{self, RangeReading, RangeReadings, RangeScanner, Sen};
use crate::protocol::{Dialect, Message};
use crate::sim::noise::Noise;
use crate::sim::physics::RobotKey;
use crate::sim::scenario::NoiseSpec;
use crate::sim::spec::{SensorKind, SensorSpec};
use crate::sim::surroundings::Surroundings;
use crate::time::{Span, Stamp};

/// Slack when a timer is compared with a tick.
const TIMER_SLACK: Span = Span(1_000);

/// When a sensor is due again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Timer {
    interval: Span,
    next: Stamp,
}

impl Timer {
    pub(crate) fn new(interval_s: f64, first: Stamp) -> Self {
        Self { interval: Span::from_seconds(interval_s), next: first }
    }

    /// Whether the timer fires at `now`; it then counts on from when it was due, so that the mean
    /// interval is kept however long frames take.
    pub(crate) fn fires(&mut self, now: Stamp) -> bool {
        if now + TIMER_SLACK < self.next {
            return false;
        }
        self.next = self.next + self.interval;
        if self.next <= now {
            self.next = now + self.interval;
        }
        true
    }
}

/// A sensor or effecter of any kind.
#[derive(Clone, Debug)]
pub(crate) enum Device {
    Scanner(Scanner),
    Sonar(Sonar),
    Beam(Beam),
    IrScanner(IrScanner),
    Odometry(Odometry),
    Encoder(Encoder),
    Ins(Ins),
    Bumper(Bumper),
    Victims(VictimSensor),
    Tags(TagReader),
    Releaser(Releaser),
    Truth(WorldPose),
    Receiver(Receiver),
    Tachometer(Tachometer),
    Motion(MotionSensor),
    Gauge(Gauge),
    Objects(ObjectSensor),
    Ears(Ears),
    Depth(DepthCamera),
    Camera(Camera),
    Battery(Mounting),
}

impl Device {
    pub(crate) fn mounting(&self) -> &Mounting {
        match self {
            Self::Scanner(it) => &it.mounting,
            Self::Sonar(it) => &it.mounting,
            Self::Beam(it) => &it.mounting,
            Self::IrScanner(it) => &it.beam.mounting,
            Self::Odometry(it) => &it.mounting,
            Self::Encoder(it) => &it.mounting,
            Self::Ins(it) => &it.mounting,
            Self::Bumper(it) => &it.mounting,
            Self::Victims(it) => &it.mounting,
            Self::Tags(it) => &it.mounting,
            Self::Releaser(it) => &it.mounting,
            Self::Truth(it) => &it.mounting,
            Self::Receiver(it) => &it.mounting,
            Self::Tachometer(it) => &it.mounting,
            Self::Motion(it) => &it.mounting,
            Self::Gauge(it) => &it.mounting,
            Self::Objects(it) => &it.mounting,
            Self::Ears(it) => &it.mounting,
            Self::Depth(it) => &it.mounting,
            Self::Camera(it) => &it.mounting,
            Self::Battery(mounting) => mounting,
        }
    }
}

/// A device with its kind and its clock.
#[derive(Clone, Debug)]
pub(crate) struct Item {
    pub(crate) kind: SensorKind,
    pub(crate) device: Device,
    /// Seconds between readings as the file says.
    pub(crate) interval_s: Option<f64>,
    timer: Option<Timer>,
    /// A line that was cast and waits for its burst.
    waiting: Option<RangeScanner>,
}

/// The instant at which sensors are read, and what is known then.
pub(crate) struct Instant<'a> {
    pub(crate) carrier: Carrier<'a>,
    pub(crate) surroundings: Surroundings<'a>,
    pub(crate) tags: &'a TagMemory,
    /// As the lines are stamped.
    pub(crate) stamp: Stamp,
    /// Level time, which runs on when a fault makes the stamps jump.
    pub(crate) now: Stamp,
    /// Factor of a fault on the odometry.
    pub(crate) odometry_scale: f64,
    /// Types and names of sensors that a fault has silenced; an empty text means all.
    pub(crate) silenced: &'a [String],
}

impl Instant<'_> {
    fn silent(&self, item: &Item) -> bool {
        let name = &item.device.mounting().name;
        self.silenced.iter().any(|what| {
            what.is_empty()
                || what.eq_ignore_ascii_case(item.kind.name())
                || what.eq_ignore_ascii_case(name)
        })
    }
}

/// All sensors of one robot.
#[derive(Clone, Debug)]
pub(crate) struct Suite {
    dialect: Dialect,
    pub(crate) items: Vec<Item>,
    bursts: u64,
}

/// The types of a burst in the order of a real recording; touch, which it lacks, after the encoders,
/// and infrared after its likes.
const BURST_ORDER: [SensorKind; 16] = [
    SensorKind::Sonar,
    SensorKind::Range,
    SensorKind::Ir,
    SensorKind::RangeScanner,
    SensorKind::IrScanner,
    SensorKind::RangeImager,
    SensorKind::Ins,
    SensorKind::Odometry,
    SensorKind::Encoder,
    SensorKind::Touch,
    SensorKind::Rfid,
    SensorKind::VictSensor,
    SensorKind::Sound,
    SensorKind::GroundTruth,
    SensorKind::Gps,
    SensorKind::Tachometer,
];

impl Suite {
    /// The sensors of `carrier`'s class at `now`; each draws from a noise stream of its own.
    pub(crate) fn new(
        carrier: &Carrier<'_>,
        dialect: Dialect,
        noise: &NoiseSpec,
        seed: u64,
        key: RobotKey,
        now: Stamp,
    ) -> Self {
        let items = carrier
            .class
            .sensor
            .iter()
            .enumerate()
            .map(|(number, spec)| {
                let stream = u64::from(key.0) * 1024 + number as u64;
                let mut phase = Noise::new(seed, stream | 1 << 40);
                let source = Noise::new(seed, stream);
                let timer = match (dialect, spec.interval_s) {
                    // Scanners of interval 0 report when told to.
                    (_, Some(0.0)) => None,
                    (Dialect::Ut2004, interval) => interval.map(|s| Timer::new(s, now)),
                    // Timers of the UDK server start when the item spawns, unaligned.
                    (Dialect::Udk, interval) => {
                        let seconds = interval.unwrap_or(default_interval_s(spec.kind));
                        let first = now + Span::from_seconds(seconds * phase.unit());
                        Some(Timer::new(seconds, first))
                    }
                };
                Item {
                    kind: spec.kind,
                    device: device(spec, carrier, dialect, noise, source, now),
                    interval_s: spec.interval_s,
                    timer,
                    waiting: None,
                }
            })
            .collect();
        Self { dialect, items, bursts: 0 }
    }

    /// UT2004: casts the scanners' lines, which the next burst carries, stamped as the burst before.
    pub(crate) fn scan(&mut self, instant: &Instant<'_>) {
        for item in &mut self.items {
            if let Device::Scanner(scanner) = &mut item.device
                && item.interval_s != Some(0.0)
                && item.timer.as_mut().is_none_or(|timer| timer.fires(instant.now))
            {
                let line = scanner.cast(&instant.carrier, &instant.surroundings, instant.stamp);
                item.waiting = Some(line);
            }
        }
    }

    /// UT2004: the sensor lines of one burst.
    ///
    /// The first burst after the spawn has no sonar, scanner, INS and odometry yet, as recorded.
    pub(crate) fn burst(&mut self, instant: &Instant<'_>) -> Vec<Message> {
        const LATE: [SensorKind; 4] =
            [SensorKind::Sonar, SensorKind::RangeScanner, SensorKind::Ins, SensorKind::Odometry];
        let first = self.bursts == 0;
        self.bursts += 1;
        let mut lines = Vec::new();
        for kind in BURST_ORDER {
            let mut group = Vec::new();
            for item in self.items.iter_mut().filter(|item| item.kind == kind) {
                // A scanner's clock rules its casts, a tag reader's its repeats.
                let own = matches!(kind, SensorKind::RangeScanner | SensorKind::Rfid);
                let timed = item.timer.is_some() && !own;
                if timed && !item.timer.as_mut().is_some_and(|timer| timer.fires(instant.now)) {
                    continue;
                }
                let reading = item.read(instant, self.dialect);
                if !instant.silent(item) {
                    group.extend(reading);
                }
            }
            if !(first && LATE.contains(&kind)) {
                lines.extend(grouped(group));
            }
        }
        lines
    }

    /// UDK: the lines of the sensors whose timers fire.
    pub(crate) fn timed(&mut self, instant: &Instant<'_>) -> Vec<Message> {
        let mut lines = Vec::new();
        for item in &mut self.items {
            if !item.timer.as_mut().is_some_and(|timer| timer.fires(instant.now)) {
                continue;
            }
            if let Device::Scanner(scanner) = &mut item.device {
                let line = scanner.cast(&instant.carrier, &instant.surroundings, instant.stamp);
                item.waiting = Some(line);
            }
            let reading = item.read(instant, self.dialect);
            if !instant.silent(item) {
                lines.extend(reading);
            }
        }
        lines
    }

    /// A line of the scanner of `kind` and `name` (all if empty) at once, as `SET … Scan` asks for.
    pub(crate) fn scan_now(
        &mut self,
        kind: SensorKind,
        name: &str,
        instant: &Instant<'_>,
    ) -> Vec<Message> {
        let mut lines = Vec::new();
        for item in &mut self.items {
            let own = &item.device.mounting().name;
            let meant = name.is_empty() || own.eq_ignore_ascii_case(name);
            if item.kind != kind || !meant || instant.silent(item) {
                continue;
            }
            if let Device::Scanner(scanner) = &mut item.device {
                let line = scanner.cast(&instant.carrier, &instant.surroundings, instant.stamp);
                lines.push(Message::Sen(Sen::RangeScanner(line)));
            } else {
                lines.extend(item.read(instant, self.dialect));
            }
        }
        lines
    }

    /// Items of a kind, or of a kind and name, without regard to case.
    pub(crate) fn of<'a>(
        &'a mut self,
        kind: SensorKind,
        name: &'a str,
    ) -> impl Iterator<Item = &'a mut Device> {
        self.items
            .iter_mut()
            .filter(move |item| {
                item.kind == kind
                    && (name.is_empty() || item.device.mounting().name.eq_ignore_ascii_case(name))
            })
            .map(|item| &mut item.device)
    }
}

/// Seconds between the lines of a UDK sensor that no file gives (protocol document 6.1).
pub(crate) fn default_interval_s(kind: SensorKind) -> f64 {
    match kind {
        SensorKind::RangeScanner | SensorKind::Ins | SensorKind::Tachometer | SensorKind::Sonar => {
            0.2
        }
        SensorKind::ObjectSensor => 0.5,
        SensorKind::Acoustic => 1.0,
        _ => 0.1,
    }
}

fn device(
    spec: &SensorSpec,
    carrier: &Carrier<'_>,
    dialect: Dialect,
    noise: &NoiseSpec,
    source: Noise,
    now: Stamp,
) -> Device {
    let units = carrier.units;
    match spec.kind {
        SensorKind::RangeScanner => {
            Device::Scanner(Scanner::new(spec, units, dialect, noise, source))
        }
        SensorKind::Sonar => Device::Sonar(Sonar::new(spec, units, dialect, noise, source)),
        SensorKind::Ir | SensorKind::Range => {
            Device::Beam(Beam::new(spec, units, dialect, noise, source))
        }
        SensorKind::IrScanner => {
            Device::IrScanner(IrScanner::new(spec, units, dialect, noise, source))
        }
        SensorKind::Accel | SensorKind::AcceleroMeter | SensorKind::Imu => {
            Device::Motion(MotionSensor::new(spec, carrier, now))
        }
        SensorKind::AltitudeSensor | SensorKind::MagneticCompass | SensorKind::MissionTime => {
            Device::Gauge(Gauge::new(spec, carrier, now))
        }
        SensorKind::Acoustic | SensorKind::Sound => Device::Ears(Ears::new(spec, carrier, now)),
        SensorKind::ObjectSensor => Device::Objects(ObjectSensor::new(spec, units)),
        SensorKind::Odometry => {
            Device::Odometry(Odometry::new(spec, units, dialect, noise, source))
        }
        SensorKind::Encoder => Device::Encoder(Encoder::new(spec, carrier, dialect, noise, source)),
        SensorKind::Ins => Device::Ins(Ins::new(spec, carrier, noise, source)),
        SensorKind::Touch => Device::Bumper(Bumper::new(spec, units)),
        SensorKind::VictSensor => Device::Victims(VictimSensor::new(spec, units, noise, source)),
        SensorKind::Rfid => Device::Tags(TagReader::new(spec, units)),
        SensorKind::RfidReleaser => Device::Releaser(Releaser::new(spec, units)),
        SensorKind::GroundTruth => Device::Truth(WorldPose::new(spec, units, dialect)),
        SensorKind::Gps => Device::Receiver(Receiver::new(spec, units)),
        SensorKind::Tachometer => Device::Tachometer(Tachometer::new(spec, carrier)),
        SensorKind::RangeImager => Device::Depth(DepthCamera::new(spec, units)),
        SensorKind::Camera => Device::Camera(Camera::new(spec, units)),
        SensorKind::Battery => Device::Battery(Mounting::new(spec, units)),
    }
}

impl Item {
    /// One reading, if the device gives one now.
    fn read(&mut self, instant: &Instant<'_>, dialect: Dialect) -> Option<Message> {
        let Instant { carrier, surroundings, stamp, .. } = instant;
        // UT2004 stamps neither odometry nor encoders nor bumpers.
        let udk_time = (dialect == Dialect::Udk).then_some(*stamp);
        let sen = match &mut self.device {
            Device::Scanner(_) => Sen::RangeScanner(self.waiting.take()?),
            Device::Sonar(sonar) => Sen::Sonar(RangeReadings {
                time: Some(*stamp),
                readings: vec![RangeReading {
                    name: sonar.mounting.name.clone(),
                    range_m: sonar.measure(carrier, surroundings),
                }],
                extra: Vec::new(),
            }),
            Device::Beam(beam) => {
                let line = RangeReadings {
                    time: Some(*stamp),
                    readings: vec![beam.read(carrier, surroundings)],
                    extra: Vec::new(),
                };
                if self.kind == SensorKind::Ir { Sen::Ir(line) } else { Sen::Range(line) }
            }
            Device::IrScanner(scanner) => {
                Sen::IrScanner(scanner.cast(carrier, surroundings, *stamp))
            }
            Device::Motion(motion) if self.kind == SensorKind::Imu => {
                Sen::Imu(motion.inertial(carrier, instant.now, *stamp))
            }
            Device::Motion(motion) => {
                let proper = self.kind == SensorKind::AcceleroMeter;
                Sen::Acceleration(motion.acceleration(carrier, proper, instant.now, *stamp))
            }
            Device::Gauge(gauge) => match self.kind {
                SensorKind::AltitudeSensor => Sen::Altitude(gauge.altitude(carrier, *stamp)),
                SensorKind::MagneticCompass => Sen::Compass(gauge.compass(carrier, *stamp)),
                _ => Sen::MissionTime(gauge.minutes(instant.now, *stamp)),
            },
            Device::Ears(ears) if self.kind == SensorKind::Sound => {
                Sen::Sound(ears.sound(carrier, surroundings, instant.now)?)
            }
            Device::Ears(ears) => {
                Sen::Acoustic(ears.acoustic(carrier, surroundings, instant.now, *stamp))
            }
            Device::Objects(sensor) => Sen::ObjectSensor(sensor.read(carrier, surroundings)),
            Device::Odometry(odometry) => {
                odometry.update(carrier, instant.odometry_scale);
                Sen::Odometry(odometry.read(udk_time))
            }
            Device::Encoder(encoder) => Sen::Encoder(sen::Encoder {
                time: udk_time,
                readings: vec![encoder.read(carrier)],
                extra: Vec::new(),
            }),
            Device::Ins(ins) => {
                ins.update(carrier);
                Sen::Ins(ins.read())
            }
            Device::Bumper(bumper) => Sen::Touch(sen::Touch {
                time: udk_time,
                readings: vec![bumper.read(carrier)],
                extra: Vec::new(),
            }),
            Device::Victims(sensor) => {
                Sen::VictSensor(sensor.cycle(carrier, surroundings, *stamp)?)
            }
            Device::Tags(reader) => Sen::Rfid(reader.cycle(carrier, instant.tags, *stamp)?),
            Device::Truth(truth) => return Some(Message::GroundTruth(truth.read(carrier, *stamp))),
            Device::Receiver(receiver) => {
                Sen::Gps(sen::Gps { time: udk_time, ..receiver.read(carrier) })
            }
            Device::Tachometer(tachometer) => Sen::Tachometer(tachometer.read(carrier, *stamp)),
            Device::Depth(depth) => Sen::RangeImager(depth.read(carrier, surroundings, *stamp)),
            Device::Camera(_) | Device::Releaser(_) | Device::Battery(_) => return None,
        };
        Some(Message::Sen(sen))
    }
}

/// UT2004 writes like sonars, encoders and bumpers into one line, other sensors each into their own.
fn grouped(lines: Vec<Message>) -> Vec<Message> {
    let mut grouped: Vec<Message> = Vec::new();
    for line in lines {
        match (grouped.last_mut(), line) {
            (Some(Message::Sen(Sen::Sonar(all))), Message::Sen(Sen::Sonar(one)))
            | (Some(Message::Sen(Sen::Range(all))), Message::Sen(Sen::Range(one)))
            | (Some(Message::Sen(Sen::Ir(all))), Message::Sen(Sen::Ir(one))) => {
                all.readings.extend(one.readings);
            }
            (Some(Message::Sen(Sen::Encoder(all))), Message::Sen(Sen::Encoder(one))) => {
                all.readings.extend(one.readings);
            }
            (Some(Message::Sen(Sen::Touch(all))), Message::Sen(Sen::Touch(one))) => {
                all.readings.extend(one.readings);
            }
            (_, line) => grouped.push(line),
        }
    }
    grouped
}
