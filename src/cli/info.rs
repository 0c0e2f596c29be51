//! `usar info`: what a file holds.

use super::files::{Format, write_stdout};
use crate::acquisition::RecordedTriples;
use crate::files::kind::{Kind, kind_of};
use crate::files::pcd::read_pcd;
use crate::files::world::{check_map, load_world};
use crate::protocol::capture::Capture;
use crate::protocol::{RawLine, parse};
use crate::record::{Direction, Recording, What, read};
use crate::sim::RobotCatalogue;
use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `usar info`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  usar info run/session.usar --format json")]
pub struct InfoArguments {
    /// A session, run folder, captured text, triples, scan, map, scenario, robots or configuration
    file: PathBuf,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

/// Runs the verb.
///
/// # Errors
///
/// A file that cannot be read or is not of a known kind.
pub fn run(arguments: &InfoArguments) -> Result<ExitCode> {
    let (bytes, path) = super::session::read_session(&arguments.file)?;
    let facts = facts(&path, &bytes)?;
    write_stdout(&match arguments.format {
        Format::Json => serde_json::to_string_pretty(&facts)? + "\n",
        Format::Text => text(&facts),
    })?;
    Ok(ExitCode::SUCCESS)
}

fn facts(path: &Path, bytes: &[u8]) -> Result<Map<String, Value>> {
    let kind = kind_of(path, bytes)
        .with_context(|| format!("{}: not a kind of file that is known", path.display()))?;
    let more = match kind {
        Kind::Session => {
            let recording = read(bytes).with_context(|| path.display().to_string())?;
            session(&recording, bytes.len())
        }
        Kind::Captured => captured(&Capture::read(bytes)),
        Kind::Triples => triples(path, bytes)?,
        Kind::Scan => scan(path, bytes)?,
        Kind::Scenario => scenario(path)?,
        Kind::Map => map(path)?,
        Kind::Robots => robots(bytes)?,
        Kind::AgentConfig => {
            let config = crate::files::agent_config::agent_config(&[
                crate::files::agent_config::Source::file(path)?,
            ])?;
            serde_json::to_value(&config)?
        }
    };
    let mut facts = Map::new();
    facts.insert("file".into(), json!(path.display().to_string()));
    facts.insert("kind".into(), json!(kind.to_string()));
    match more {
        Value::Object(more) => facts.extend(more),
        other => bail!("{other} is no set of facts"),
    }
    Ok(facts)
}

fn session(recording: &Recording, size: usize) -> Value {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let (mut received, mut sent) = (BTreeMap::new(), BTreeMap::new());
    for entry in &recording.entries {
        let name = match &entry.what {
            What::Received(_) => "received",
            What::Sent(_) => "sent",
            What::Operator(_) => "operator",
            What::Wake => "wake",
            What::Connected => "connected",
            What::Disconnected(_) => "disconnected",
            What::Ended(_) => "ended",
        };
        *counts.entry(name).or_default() += 1;
        match entry.what.line() {
            Some((Direction::Received, line)) => count_line(&mut received, line),
            Some((Direction::Sent, line)) => count_line(&mut sent, line),
            None => {}
        }
    }
    let header = &recording.header;
    json!({
        "bytes": size,
        "scenario": header.scenario,
        "seed": header.seed,
        "placement": header.placement,
        "seconds": recording.entries.last().map_or(0.0, |last| last.arrival.seconds()),
        "entries": recording.entries.len(),
        "kinds": counts,
        "received": received,
        "sent": sent,
        "loss": recording.loss,
    })
}

fn captured(capture: &Capture) -> Value {
    let mut received = BTreeMap::new();
    let mut damaged = 0;
    let (mut first, mut last): (Option<f64>, Option<f64>) = (None, None);
    for line in &capture.lines {
        count_line(&mut received, &line.octets);
        let parsed = parse(&line.octets);
        damaged += usize::from(!parsed.problems.is_empty());
        if let Some(time) = parsed.message.time() {
            first = first.or(Some(time.seconds()));
            last = Some(last.map_or(time.seconds(), |last| last.max(time.seconds())));
        }
    }
    json!({
        "lines": capture.lines.len(),
        "put_together": capture.rejoined(),
        "remarks": capture.remarks.len(),
        "damaged": damaged,
        "from_s": first,
        "to_s": last,
        "received": received,
    })
}

fn triples(path: &Path, bytes: &[u8]) -> Result<Value> {
    let record = RecordedTriples::parse(&String::from_utf8_lossy(bytes))
        .with_context(|| path.display().to_string())?;
    let triples = record.triples();
    Ok(json!({
        "triples": triples.len(),
        "columns": triples.first().map(|first| first.line.len()),
        "from_s": triples.first().map(|first| first.stamp.seconds()),
        "to_s": triples.last().map(|last| last.stamp.seconds()),
        "sweeps": record.sweeps().len(),
        "mount": record.mount().is_some(),
    }))
}

/// Counts a line under its verb, sensor lines under their type.
fn count_line(counts: &mut BTreeMap<String, usize>, line: &[u8]) {
    let raw = RawLine::parse(line.trim_ascii_end(), &mut Vec::new());
    let name = match raw.get("Type") {
        Some(kind) if raw.is("SEN") => format!("SEN {kind}"),
        _ => raw.verb.clone(),
    };
    *counts.entry(name).or_default() += 1;
}

fn scan(path: &Path, bytes: &[u8]) -> Result<Value> {
    let cloud = read_pcd(bytes).with_context(|| path.display().to_string())?;
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    let mut hits = 0;
    for point in cloud.points.iter().filter(|point| point.iter().all(|v| v.is_finite())) {
        hits += 1;
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    let bound = |v: [f32; 3]| if hits > 0 { json!(v) } else { Value::Null };
    Ok(json!({
        "rows": cloud.height,
        "columns": cloud.width,
        "organised": cloud.height > 1,
        "points": hits,
        "low_m": bound(low),
        "high_m": bound(high),
        "viewpoint": cloud.viewpoint,
    }))
}

fn scenario(path: &Path) -> Result<Value> {
    let files = load_world(path)?;
    let scenario = &files.scenario;
    let robots: Vec<Value> = scenario
        .robots
        .iter()
        .map(|robot| json!({"name": robot.name, "class": robot.class, "start": robot.start}))
        .collect();
    Ok(json!({
        "map": scenario.map,
        "level": files.map.name,
        "time_limit_s": scenario.time_limit_s,
        "seed": scenario.seed,
        "dialect": format!("{:?}", scenario.dialect).to_lowercase(),
        "robots": robots,
        "phases": scenario.phases.len(),
        "faults": scenario.faults.len(),
        "victims": files.world.victims().len(),
        "portals": files.world.portals().len(),
    }))
}

fn map(path: &Path) -> Result<Value> {
    let (map, world) = check_map(path)?;
    Ok(json!({
        "name": map.name,
        "bounds_m": map.bounds,
        "objects": world.objects().len(),
        "meshes": map.meshes.len(),
        "starts": world.starts().iter().map(|start| start.name.as_str()).collect::<Vec<_>>(),
        "victims": world.victims().len(),
        "false_alarms": world.false_alarms().len(),
        "rfid_tags": world.tags().len(),
        "portals": world.portals().len(),
    }))
}

fn robots(bytes: &[u8]) -> Result<Value> {
    let catalogue = RobotCatalogue::parse(&String::from_utf8_lossy(bytes))?;
    let robots: Vec<Value> = catalogue
        .robots
        .iter()
        .map(|robot| {
            json!({
                "class": robot.class,
                "dialect": format!("{:?}", robot.dialect).to_lowercase(),
                "mass_kg": robot.mass_kg(),
                "sensors": robot.sensor.len(),
                "pan_tilts": robot.pan_tilt.len(),
            })
        })
        .collect();
    Ok(json!({ "robots": robots }))
}

/// The facts one a line; what is nested is indented.
fn text(facts: &Map<String, Value>) -> String {
    let mut text = String::new();
    lines(&mut text, facts, 0);
    text
}

fn lines(text: &mut String, facts: &Map<String, Value>, indent: usize) {
    for (key, value) in facts {
        let _ = write!(text, "{:indent$}{key}:", "");
        match value {
            Value::Object(inner) if !inner.is_empty() => {
                text.push('\n');
                lines(text, inner, indent + 2);
            }
            Value::Array(items) if items.iter().any(Value::is_object) => {
                text.push('\n');
                for item in items {
                    let _ = writeln!(text, "{:indent$}  {item}", "");
                }
            }
            Value::String(word) => {
                let _ = writeln!(text, " {word}");
            }
            Value::Null => text.push_str(" -\n"),
            other => {
                let _ = writeln!(text, " {other}");
            }
        }
    }
}
