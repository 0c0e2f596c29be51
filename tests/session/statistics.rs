//! The stand-in beside the one real recording: a P2DX that drives slowly ahead in the same room.

use crate::protocol::reference_data;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use usar_agent::files::world::load_world;
use usar_agent::protocol::capture::Capture;
use usar_agent::protocol::message::Sen;
use usar_agent::protocol::{Framed, LineSplitter, Message, RawLine, parse};
use usar_agent::sim::Session;
use usar_agent::time::Span;

/// Spin of the wheels in the recording: 71 counts of 0.01745 rad in 5.4 s.
const SPIN: &str = "DRIVE {Left 0.229} {Right 0.229}\r\n";

/// What is compared.
#[derive(Debug)]
struct Statistics {
    /// Seconds between STA lines: least, middle, greatest, mean.
    intervals_s: [f64; 4],
    /// Kinds of the lines of a burst, in order, for each form that occurs.
    bursts: BTreeSet<String>,
    /// Bursts by which the scanner's time lags.
    scanner_lag: BTreeSet<i64>,
    /// Decimals by kind and key.
    decimals: BTreeMap<String, BTreeSet<usize>>,
    /// Relative standard deviation and greatest deviation of a beam along a wall that the robot
    /// drives beside.
    wall_noise: [f64; 2],
    /// Metres of odometry for one count of the encoders, the mean of left and right.
    metres_per_count: f64,
    /// Least step of the odometry in metres.
    odometry_step_m: f64,
    /// Greatest heading of a straight drive by odometry, in radians: the stand-in's wheels creep
    /// apart by about 0.01 rad/s, which a robot as slow as the recording's shows.
    heading_rad: f64,
    /// Metres of odometry for one metre of ground truth.
    odometry_per_truth: f64,
}

/// Both side by side, a row for each thing that is compared.
fn table(recording: &Statistics, stand_in: &Statistics) -> String {
    let mut rows = vec![["".to_owned(), "recording".to_owned(), "stand-in".to_owned()]];
    let mut row = |what: &str, of: &dyn Fn(&Statistics) -> String| {
        rows.push([what.to_owned(), of(recording), of(stand_in)]);
    };
    for (index, which) in ["least", "middle", "greatest", "mean"].into_iter().enumerate() {
        row(&format!("seconds between bursts, {which}"), &|of| {
            format!("{:.3}", of.intervals_s[index])
        });
    }
    row("bursts the scanner's time lags", &|of| format!("{:?}", of.scanner_lag));
    row("noise of a straight wall, standard deviation", &|of| {
        format!("{:.4} %", of.wall_noise[0] * 100.0)
    });
    row("noise of a straight wall, greatest", &|of| format!("{:.4} %", of.wall_noise[1] * 100.0));
    row("odometry for one encoder count", &|of| format!("{:.3} mm", of.metres_per_count * 1e3));
    row("least step of the odometry", &|of| format!("{:.2} mm", of.odometry_step_m * 1e3));
    row("odometry for one metre of truth", &|of| format!("{:.4} m", of.odometry_per_truth));
    row("greatest heading of a straight drive", &|of| format!("{:.4} rad", of.heading_rad));
    let kinds = recording.bursts.union(&stand_in.bursts);
    for (number, burst) in (1..).zip(kinds) {
        let whether = |of: &Statistics| of.bursts.contains(burst).to_string();
        row(&format!("burst {number}: {burst}"), &whether);
    }
    let numbers = [recording, stand_in].map(|of| of.decimals.iter().filter(|(_, n)| !n.is_empty()));
    let keys: BTreeSet<&String> = numbers.into_iter().flatten().map(|(key, _)| key).collect();
    for key in keys {
        row(&format!("decimals of {key}"), &|of| match of.decimals.get(key) {
            Some(counts) => counts.iter().map(usize::to_string).collect::<Vec<_>>().join(" or "),
            None => "absent".to_owned(),
        });
    }
    let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or_default();
    let [what, one] = [0, 1].map(width);
    rows.iter().map(|[a, b, c]| format!("{a:what$}  {b:one$}  {c}\n")).collect()
}

fn kind(line: &RawLine) -> String {
    match line.get("Type").filter(|_| line.is("SEN")) {
        Some(kind) => kind.to_owned(),
        None => line.verb.clone(),
    }
}

/// Decimals of the first number of a segment's value; none for a text.
fn decimals(value: &str) -> Option<usize> {
    let first = value.split([',', ' ']).find(|word| word.parse::<f64>().is_ok())?;
    Some(first.split_once('.').map_or(0, |(_, fraction)| fraction.len()))
}

fn statistics(lines: &[Vec<u8>]) -> Statistics {
    let raw: Vec<RawLine> =
        lines.iter().map(|line| RawLine::parse(line, &mut Vec::new())).collect();
    let mut by_key: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
    for line in &raw {
        for segment in &line.segments {
            let numbers = decimals(segment.value());
            let key = format!("{} {}", kind(line), segment.key());
            by_key.entry(key).or_default().extend(numbers);
        }
    }
    let messages: Vec<Message> = lines.iter().map(|line| parse(line).message).collect();
    let seconds = |m: &Message| m.time().map(usar_agent::time::Stamp::seconds);
    let status: Vec<f64> =
        messages.iter().filter(|m| matches!(m, Message::Sta(_))).filter_map(seconds).collect();
    let mut gaps: Vec<f64> = status.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let mean = (status[status.len() - 1] - status[0]) / gaps.len() as f64;
    let shapes = raw[1..].split_inclusive(|line| line.is("STA"));
    // Sensors that report now and then are left out of the order; the last burst may be cut.
    let whole = shapes.filter(|burst| burst.last().is_some_and(|line| line.is("STA")));
    let bursts = whole
        .map(|burst| {
            let kinds = burst.iter().map(kind);
            let steady = kinds.filter(|kind| !["RFID", "VictSensor"].contains(&kind.as_str()));
            steady.collect::<Vec<_>>().join(" ")
        })
        .collect();
    let scans: Vec<(f64, Vec<f64>)> = messages
        .iter()
        .filter_map(|m| match m {
            Message::Sen(Sen::RangeScanner(scan)) => Some((seconds(m)?, scan.ranges_m.clone())),
            _ => None,
        })
        .collect();
    let mut scanner_lag = BTreeSet::new();
    let mut burst = 0;
    for message in &messages {
        match message {
            Message::Sen(Sen::RangeScanner(_)) => {
                let own = seconds(message).unwrap();
                let of = status.iter().position(|t| (t - own).abs() < 0.006).unwrap();
                scanner_lag.insert(burst - of as i64);
            }
            Message::Sta(_) => burst += 1,
            _ => {}
        }
    }
    let beam: Vec<f64> = scans.iter().map(|(_, ranges)| ranges[0]).collect();
    let middle = beam.iter().sum::<f64>() / beam.len() as f64;
    let relative: Vec<f64> = beam.iter().map(|range| range / middle - 1.0).collect();
    let spread = (relative.iter().map(|r| r * r).sum::<f64>() / beam.len() as f64).sqrt();
    let greatest = relative.iter().fold(0.0_f64, |most, r| most.max(r.abs()));
    let poses: Vec<[f64; 2]> = messages
        .iter()
        .filter_map(|m| match m {
            Message::Sen(Sen::Odometry(pose)) => Some([pose.x_m, pose.theta_rad]),
            _ => None,
        })
        .collect();
    let counts: Vec<f64> = messages
        .iter()
        .filter_map(|m| match m {
            Message::Sen(Sen::Encoder(encoder)) => {
                let [left, right] = [0, 1].map(|wheel: usize| encoder.readings[wheel].tick as f64);
                Some((left + right) / 2.0)
            }
            _ => None,
        })
        .collect();
    let truth: Vec<f64> = messages
        .iter()
        .filter_map(|m| match m {
            Message::GroundTruth(truth) => Some(truth.pose.location[0]),
            _ => None,
        })
        .collect();
    let way = |values: &[f64]| values[values.len() - 1] - values[0];
    let x: Vec<f64> = poses.iter().map(|pose| pose[0]).collect();
    // All ways are whole numbers of half steps of one wheel; four decimals blur them.
    let steps = x.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 2e-4);
    Statistics {
        intervals_s: [gaps[0], gaps[gaps.len() / 2], gaps[gaps.len() - 1], mean],
        bursts,
        scanner_lag,
        decimals: by_key,
        wall_noise: [spread, greatest],
        metres_per_count: way(&x) / -way(&counts),
        odometry_step_m: steps.fold(f64::INFINITY, f64::min),
        heading_rad: poses.iter().fold(0.0, |most, pose| most.max(pose[1].abs())),
        odometry_per_truth: way(&x) / way(&truth),
    }
}

/// The stand-in's lines over as many bursts as the recording has.
fn stand_in(bursts: usize) -> Vec<Vec<u8>> {
    let files = load_world(Path::new("yellow")).unwrap();
    let mut session = Session::new(&files.world, &files.scenario, &files.catalogue).unwrap();
    let client = session.connect();
    let init = "INIT {ClassName USARBot.P2DX} {Location 4.5,1.9,1.8} {Name R1}\r\n";
    session.receive(client, format!("{init}{SPIN}").as_bytes());
    let mut splitter = LineSplitter::default();
    let mut lines: Vec<Vec<u8>> = Vec::new();
    while lines.iter().filter(|line| line.starts_with(b"STA")).count() < bursts {
        session.advance(Span::from_millis(10));
        splitter.push(&session.take_output(client));
        while let Some(framed) = splitter.next_line() {
            if let Framed::Line(line) = framed {
                lines.push(line.to_vec());
            }
        }
    }
    lines
}

#[test]
fn the_stand_in_tells_what_the_recording_tells_and_in_the_same_way() {
    let Some(text) = reference_data("usarsim-session/session_30_scans.txt") else { return };
    let recorded: Vec<Vec<u8>> =
        Capture::read(&text).lines.into_iter().map(|line| line.octets).collect();
    let (real, ours) = (statistics(&recorded), statistics(&stand_in(31)));
    println!("{}", table(&real, &ours));
    for (a, b) in real.intervals_s.into_iter().zip(ours.intervals_s) {
        assert!(
            (a - b).abs() < 0.012,
            "intervals {:?} and {:?}",
            real.intervals_s,
            ours.intervals_s
        );
    }
    assert_eq!(ours.bursts, real.bursts);
    assert_eq!(ours.scanner_lag, real.scanner_lag);
    assert_eq!(ours.decimals, real.decimals);
    // Thirty draws tell a standard deviation to an eighth.
    let ratio = ours.wall_noise[0] / real.wall_noise[0];
    assert!((0.6..1.6).contains(&ratio), "{:?} and {:?}", ours.wall_noise, real.wall_noise);
    assert!(ours.wall_noise[1] < 0.0013 && real.wall_noise[1] < 0.0013);
    let near = |a: f64, b: f64, part: f64| (a / b - 1.0).abs() < part;
    assert!(near(ours.metres_per_count, real.metres_per_count, 0.04));
    assert!(near(ours.odometry_per_truth, real.odometry_per_truth, 0.1));
    assert!((ours.odometry_step_m - real.odometry_step_m).abs() < 2e-3);
    assert!(ours.heading_rad < 0.05 && real.heading_rad < 0.05, "both drive straight");
}
