//! An acquisition at the socket of a simulated robot that stands still, with the truth beside it.

use nalgebra::Isometry3;
use std::path::Path;
use usar_agent::acquisition::{
    Acquisition, AcquisitionConfig, CalibrationReport, HeadAction, HeadEvent, Scan, SweepRequest,
};
use usar_agent::files::scenario;
use usar_agent::mission::{
    BodyAttitude, MotionTracker, Opening, OpeningConfig, OpeningStep, Placement, PlanarPose,
};
use usar_agent::protocol::message::Sen;
use usar_agent::protocol::{
    Command, Dialect, Framed, LineSplitter, MAX_LINE_OCTETS, Message, encode_command, parse,
};
use usar_agent::robot::{BodySpeed, Rig};
use usar_agent::scan::ImageRow;
use usar_agent::sim::{CastTruth, ConnectionId, FaultSpec, PanTiltSpec, SensorSpec, Session};
use usar_agent::time::{Arrival, Span, Stamp};

/// What differs from the scenario as it stands.
#[derive(Clone, Debug, Default)]
pub struct Setting {
    /// The scenario, by name.
    pub scenario: &'static str,
    pub dialect: Dialect,
    /// Whether the pan-tilt reports its angles.
    pub readings: bool,
    pub seed: u64,
    pub faults: Vec<FaultSpec>,
    /// Top speed of the pan-tilt's links in radians per second, instead of its own.
    pub tilt_speed_rad_s: Option<f64>,
    /// Instead of the class's scanner.
    pub scanner: Option<SensorSpec>,
}

impl Setting {
    pub fn new(dialect: Dialect, readings: bool) -> Self {
        // UDK's own robot carries no pan-tilt; that scenario gives it one.
        let scenario = if dialect == Dialect::Udk { "station_udk" } else { "box" };
        Self { scenario, dialect, readings, seed: 1, ..Self::default() }
    }
}

/// One robot, one client, one time.
pub struct Bench {
    session: Session,
    connection: ConnectionId,
    splitter: LineSplitter,
    now: Arrival,
    latest: Stamp,
    pub rig: Rig,
    pub acquisition: Acquisition,
    /// Where the tilt truly was, line by line.
    pub casts: Vec<CastTruth>,
    motion: MotionTracker,
    /// The robot by odometry and inertial unit, from where it stood first.
    pub frame_from_robot: Isometry3<f64>,
    finished: Option<Scan>,
    calibrated: Option<CalibrationReport>,
    /// Lines of text sent since the last look.
    pub sent: Vec<String>,
}

const STEP: Span = Span::from_millis(5);

impl Bench {
    /// A robot in service.
    pub fn new(setting: &Setting, config: AcquisitionConfig) -> Self {
        let loaded = scenario::load(Path::new(setting.scenario), &[]).unwrap();
        let mut scenario = loaded.files.scenario;
        scenario.dialect = setting.dialect;
        scenario.seed = setting.seed;
        scenario.faults.clone_from(&setting.faults);
        let unit = PanTiltSpec { name: "CameraPanTilt".to_owned(), ..PanTiltSpec::default() };
        let units = scenario.robots[0].pan_tilt.get_or_insert_with(|| vec![unit]);
        units[0].status = Some(setting.readings);
        units[0].speed_rad_s = setting.tilt_speed_rad_s.or(units[0].speed_rad_s);
        if let Some(scanner) = &setting.scanner {
            let sensors = &mut scenario.robots[0].sensors;
            sensors.retain(|own| own.kind != scanner.kind);
            sensors.push(scanner.clone());
        }
        let mut session =
            Session::new(&loaded.files.world, &scenario, &loaded.files.catalogue).unwrap();
        let connection = session.connect();
        let mut splitter = LineSplitter::new(MAX_LINE_OCTETS);
        let mut now = Arrival::default();
        let rig = open(&mut session, connection, &mut splitter, &mut now, setting.dialect);
        let acquisition = Acquisition::for_rig(&rig, config).unwrap();
        let mut bench = Self {
            session,
            connection,
            splitter,
            now,
            latest: Stamp::default(),
            rig,
            acquisition,
            casts: Vec::new(),
            motion: MotionTracker::default(),
            frame_from_robot: Isometry3::identity(),
            finished: None,
            calibrated: None,
            sent: Vec::new(),
        };
        bench.run(3.0);
        bench
    }

    /// Finds out how the tilt moves.
    pub fn calibrate(&mut self) -> CalibrationReport {
        let actions = self.acquisition.calibrate(self.now);
        self.act(actions);
        for _ in 0..24_000 {
            if let Some(report) = self.calibrated.take() {
                return report;
            }
            self.step();
        }
        panic!("a calibration ends within two minutes, however slow the line");
    }

    /// Turns the wheels so that the robot drives straight on.
    pub fn drive(&mut self, linear_mps: f64) {
        let command = self.rig.drive_command(BodySpeed { linear_mps, angular_rps: 0.0 });
        self.send(&command);
    }

    /// Takes a scan.
    pub fn take(&mut self, request: SweepRequest) -> Scan {
        let actions = self.acquisition.start(request, self.now);
        self.act(actions);
        for _ in 0..120_000 {
            if let Some(scan) = self.finished.take() {
                return scan;
            }
            self.step();
        }
        panic!("a sweep ends within ten minutes");
    }

    /// Lets time pass.
    pub fn run(&mut self, seconds: f64) {
        let end = self.now + Span::from_seconds(seconds);
        while self.now < end {
            self.step();
        }
    }

    fn step(&mut self) {
        self.session.advance(STEP);
        self.now = self.now + STEP;
        self.casts.extend(self.session.take_casts(self.connection));
        for message in messages(&mut self.session, self.connection, &mut self.splitter) {
            self.message(&message);
        }
        if self.acquisition.next_wakeup().is_some_and(|at| self.now >= at) {
            self.event(&HeadEvent::Tick);
        }
    }

    fn message(&mut self, message: &Message) {
        if let Message::Sen(Sen::RangeScanner(line)) = message {
            let line = self.rig.laser_line(line, Some(self.latest)).unwrap();
            return self.event(&HeadEvent::Line(&line));
        }
        if let Some(stamp) = message.time() {
            self.latest = self.latest.max(stamp);
            self.event(&HeadEvent::Stamped(stamp));
        }
        match message {
            Message::Sen(Sen::Ins(ins)) => {
                self.motion.attitude(BodyAttitude::from(&self.rig.ins(ins)));
            }
            Message::Sen(Sen::Odometry(odometry)) => {
                let reading = self.rig.odometry(odometry);
                let wheels = PlanarPose::from(&reading);
                if let Some((increment, _)) = self.motion.wheels(wheels) {
                    self.frame_from_robot *= increment;
                }
                let stamp = reading.stamp.unwrap_or(self.latest);
                self.acquisition.moved(stamp, self.frame_from_robot);
            }
            _ => {}
        }
        if self.rig.answers_line_query(message) {
            self.event(&HeadEvent::Answered);
        }
        let reading = match message {
            Message::MisSta(state) => self.rig.head_reading(state),
            Message::AsTa(state) => self.rig.actuator_reading(state),
            _ => None,
        };
        if let Some(reading) = reading {
            self.event(&HeadEvent::Joints(reading));
        }
    }

    fn event(&mut self, event: &HeadEvent<'_>) {
        let actions = self.acquisition.handle(event, self.now);
        self.act(actions);
    }

    fn act(&mut self, actions: Vec<HeadAction>) {
        for action in actions {
            match action {
                HeadAction::Send(command) => {
                    for command in self.rig.head_commands(command.pan, command.tilt) {
                        self.send(&command);
                    }
                }
                HeadAction::Ask => {
                    let ask = self.rig.trigger_command().unwrap();
                    self.send(&ask);
                }
                HeadAction::Query => self.send(&self.rig.line_query()),
                HeadAction::Filed { .. } | HeadAction::Reach(_) => {}
                HeadAction::Finished(scan) => self.finished = Some(*scan),
                HeadAction::Calibrated(report) => self.calibrated = Some(*report),
            }
        }
    }

    fn send(&mut self, command: &Command) {
        let line = encode_command(command, self.rig.dialect);
        self.session.receive(self.connection, &line);
        self.sent.push(String::from_utf8(line).unwrap());
    }

    /// The truth of the line that a row holds.
    pub fn cast_of(&self, row: &ImageRow) -> Option<&CastTruth> {
        let stamp = row.stamp?;
        self.casts.iter().rev().find(|cast| near(cast.printed, stamp))
    }

    /// Error of each row against the true tilt when its rays were cast, in degrees.
    pub fn tilt_errors_deg(&self, scan: &Scan) -> Vec<f64> {
        let rows = scan.image.rows().iter();
        rows.filter_map(|row| {
            let cast = self.cast_of(row)?;
            Some((row.tilt_rad - cast.tilt_rad).to_degrees())
        })
        .collect()
    }
}

/// Whether two stamps are one but for the rounding to hundredths: lines are a tenth of a second apart
/// at the least.
pub fn near(a: Stamp, b: Stamp) -> bool {
    (a - b).seconds().abs() < 0.006
}

/// The share-quantile of the absolute errors.
pub fn quantile(errors: &[f64], share: f64) -> f64 {
    let mut sorted: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

fn messages(
    session: &mut Session,
    connection: ConnectionId,
    splitter: &mut LineSplitter,
) -> Vec<Message> {
    splitter.push(&session.take_output(connection));
    let mut found = Vec::new();
    while let Some(framed) = splitter.next_line() {
        if let Framed::Line(line) = framed {
            found.push(parse(line).message);
        }
    }
    found
}

fn open(
    session: &mut Session,
    connection: ConnectionId,
    splitter: &mut LineSplitter,
    now: &mut Arrival,
    dialect: Dialect,
) -> Rig {
    let config = OpeningConfig::default();
    let class = "USARBot.P3AT";
    let mut opening = Opening::new(config, class, "R1", Placement::FirstStart, *now);
    for _ in 0..10_000 {
        session.advance(STEP);
        *now = *now + STEP;
        let mut steps = Vec::new();
        for message in messages(session, connection, splitter) {
            steps.extend(opening.message(&message, Some(dialect), *now));
        }
        if opening.next_wakeup().is_some_and(|at| *now >= at) {
            steps.extend(opening.wake(*now));
        }
        for step in steps {
            match step {
                OpeningStep::Send(command) => {
                    session.receive(connection, &encode_command(&command, dialect));
                }
                OpeningStep::Warn(_) => {}
                OpeningStep::Open => return opening.rig().unwrap().build().0,
                OpeningStep::Failed(why) => panic!("{why}"),
            }
        }
    }
    panic!("an opening ends within a minute");
}
