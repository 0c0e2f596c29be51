//! The run folder: everything that a mission leaves behind.

use super::coverage::Evidence;
use super::keyframes::keyframes;
use super::landmarks::{surface_polygons, surfaces_json};
use super::map_picture::{self, Overlay};
use super::map_server::{Cell, TrinaryMap};
use super::report::{
    FrontierLeft, LinkCounts, NodTotals, PhaseReport, Report, SurfaceCounts, SweepBudget,
    SweepReport, TimeSplit, VictimCounts,
};
use super::tum::{self, TimedPose};
use super::{map3d, ply};
use crate::exploration::{Places, Walls};
use crate::mission::{Agent, Belief, Running};
use crate::terrain::{Grid, Trinary};
use nalgebra::{Isometry3, Vector3};
use serde_json::json;

/// Files by name, in the order in which they are to be written.
pub type Files = Vec<(&'static str, Vec<u8>)>;

/// The part of the report that the agent itself knows.
pub fn agent_report(agent: &Agent, scenario: &str, seed: u64) -> Report {
    let mission_time_s = agent.mission_time().seconds();
    let mut report = Report {
        scenario: scenario.to_owned(),
        seed,
        outcome: agent.outcome().map_or("running", |outcome| outcome.word()).to_owned(),
        mission_time_s,
        operator_acts: agent.operator_acts(),
        autonomy_fraction: if mission_time_s > 0.0 {
            (1.0 - agent.operated().seconds() / mission_time_s).clamp(0.0, 1.0)
        } else {
            1.0
        },
        link: LinkCounts {
            lines: agent.tally().lines,
            unknown: agent.tally().unknown_lines(),
            damaged: agent.tally().damaged,
        },
        warnings: agent.warnings().to_vec(),
        phases: vec![PhaseReport { name: "mission".into(), from_s: 0.0, to_s: mission_time_s }],
        ..Report::default()
    };
    let Some(running) = agent.running() else { return report };
    let ledger = running.ledger();
    report.time_split_s = TimeSplit {
        scan: ledger.split.scan_s,
        drive: ledger.split.drive_s,
        turn: ledger.split.turn_s,
        think: ledger.split.think_s,
        recover: ledger.split.recover_s,
    };
    report.sweeps = ledger
        .sweeps
        .iter()
        .map(|sweep| SweepReport {
            profile: sweep.profile.clone(),
            rows: sweep.rows,
            seconds: sweep.seconds,
            budget_s: SweepBudget {
                moving: sweep.budget.moving_s,
                servo: sweep.budget.servo_s,
                laser: sweep.budget.laser_s,
                idle: sweep.budget.idle_s,
            },
            tilt_sigma_deg: sweep.tilt_sigma_rad.to_degrees(),
            driven_m: sweep.driven_m,
        })
        .collect();
    report.nods = NodTotals::of(&report.sweeps);
    let [planes, spheres, cylinders] = ledger.surfaces;
    report.surfaces = SurfaceCounts { planes, spheres, cylinders };
    report.landmarks = running.belief().mapper().surface_count();
    report.associations = ledger.associations;
    report.localisation = (&ledger.fixes).into();
    report.stuck = ledger.troubles;
    report.distance_m = running.belief().path_m();
    report.victims = VictimCounts::default();
    report.frontiers_left = running
        .frontiers_left()
        .into_iter()
        .map(|left| FrontierLeft { x: left.x, y: left.y, reason: left.reason })
        .collect();
    report
}

/// Trajectory, maps and pictures of a mission.
pub fn map_files(agent: &Agent, title: &str) -> Files {
    let Some(running) = agent.running() else { return Files::new() };
    let belief = running.belief();
    let grid = belief.grid();
    let poses: Vec<TimedPose> = belief
        .trajectory()
        .into_iter()
        .map(|(stamp, pose)| TimedPose { time_s: stamp.seconds(), pose })
        .collect();
    let path: Vec<Isometry3<f64>> = poses.iter().map(|timed| timed.pose).collect();
    let places = running.places().renewed(&grid, &Walls::of(belief.mapper().landmarks()));
    let places_json = serde_json::to_vec_pretty(&places).expect("numbers are always JSON");
    let keyframes_json = serde_json::to_vec(&keyframes(belief)).expect("numbers are always JSON");
    let overlay = Overlay { places, ..overlay(running, title, &path) };
    let mapper = belief.mapper();
    // The surfaces are those of the map; the size is that of the newest scan that went into it.
    let (rows, columns) =
        belief.last_sweep().map_or((0, 0), |(_, sweep)| (sweep.rows().len(), sweep.columns()));
    let document = json!({ "rows": rows, "columns": columns, "surfaces": surfaces_json(mapper) });
    let surfaces =
        serde_json::to_vec_pretty(&document).expect("numbers and strings are always JSON");
    let shape = running.shape();
    let size = Vector3::new(shape.length_m, shape.width_m, shape.height_m);
    let trinary = trinary_map(&grid);
    vec![
        ("trajectory.tum", tum::format(&poses).into_bytes()),
        ("map.pgm", trinary.pgm()),
        ("map.yaml", trinary.yaml("map.pgm").into_bytes()),
        ("ground.png", ground_png(&grid, belief)),
        ("planes.ply", ply::format(&surface_polygons(mapper)).into_bytes()),
        ("surfaces.json", surfaces),
        ("keyframes.json", keyframes_json),
        ("places.json", places_json),
        ("map.png", map_picture::draw(&grid, &overlay).to_png()),
        (
            "map3d.png",
            map3d::draw(mapper.landmarks(), mapper.curves(), &grid, &path, &size).to_png(),
        ),
    ]
}

fn overlay(running: &Running, title: &str, path: &[Isometry3<f64>]) -> Overlay {
    Overlay {
        title: title.to_owned(),
        trajectory: path.to_vec(),
        victims: running
            .bodies()
            .iter()
            .map(|victim| (victim.place.xy(), format!("{} parts", victim.parts.len())))
            .collect(),
        frontiers: running
            .frontiers_left()
            .iter()
            .map(|left| nalgebra::Point2::new(left.x, left.y))
            .collect(),
        sweeps: running
            .belief()
            .mapper()
            .keyframes()
            .iter()
            .map(|pose| pose.translation.vector.xy().into())
            .collect(),
        places: Places::default(),
    }
}

/// The grid as the common map formats have it.
pub fn trinary_map(grid: &Grid) -> TrinaryMap {
    let cell_m = grid.cell_m();
    let low = grid.low();
    TrinaryMap {
        width: grid.width(),
        height: grid.height(),
        resolution_m: cell_m,
        origin_m: [f64::from(low.x) * cell_m, f64::from(low.y) * cell_m],
        cells: grid
            .trinary()
            .map(|cell| match cell {
                Trinary::Free => Cell::Free,
                Trinary::Occupied => Cell::Occupied,
                Trinary::Unknown => Cell::Unknown,
            })
            .collect(),
    }
}

/// What coverage counts by, from the agent's own map: heights as `ground.png` has them, so that the
/// report and whoever reads the files count alike.
pub fn evidence(grid: &Grid, belief: &Belief) -> Evidence {
    let cell_m = grid.cell_m();
    let low = grid.low();
    let mut ground_m = vec![f32::NAN; grid.cells().len()];
    for (cell, height) in belief.terrain().measured_ground() {
        if let Some(index) = grid.index(cell) {
            ground_m[index] = height_of(value_of(height));
        }
    }
    Evidence {
        cell_m,
        origin_m: [f64::from(low.x) * cell_m, f64::from(low.y) * cell_m],
        width: grid.width(),
        known: grid.trinary().map(|cell| cell != Trinary::Unknown).collect(),
        ground_m,
    }
}

/// Zero of the heights in `ground.png`.
const GROUND_ZERO: f64 = 32_768.0;
/// Steps of those heights per metre.
const GROUND_STEPS: f64 = 200.0;

/// `ground.png`: 16 bit, of `map.pgm`'s size and orientation. 0 where no ground was measured from at
/// most 8 m; else its height, (value - 32768) / 200 m.
fn ground_png(grid: &Grid, belief: &Belief) -> Vec<u8> {
    let evidence = evidence(grid, belief);
    let mut samples = Vec::with_capacity(2 * evidence.ground_m.len());
    for row in evidence.ground_m.chunks(evidence.width.max(1)).rev() {
        for height in row {
            let value = if height.is_nan() { 0 } else { value_of(f64::from(*height)) };
            samples.extend_from_slice(&value.to_be_bytes());
        }
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, grid.width() as u32, grid.height() as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&samples));
    written.expect("a picture of this size always fits into memory");
    bytes
}

/// Width and heights of a `ground.png`, the greatest y first; NaN where no ground was measured.
///
/// # Errors
///
/// When the bytes are no grey picture of 16 bits.
pub fn ground_heights(bytes: &[u8]) -> Result<(usize, Vec<f32>), String> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .map_err(|error| error.to_string())?;
    let info = reader.info();
    if (info.color_type, info.bit_depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(format!(
            "{:?} of {:?} bits, expected grey of 16",
            info.color_type, info.bit_depth
        ));
    }
    let width = info.width as usize;
    let length = reader.output_buffer_size().ok_or("the picture is too large")?;
    let mut samples = vec![0; length];
    reader.next_frame(&mut samples).map_err(|error| error.to_string())?;
    let values = samples.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
    Ok((width, values.map(height_of).collect()))
}

/// The value of `ground.png` that is nearest to a height.
fn value_of(height_m: f64) -> u16 {
    (GROUND_ZERO + GROUND_STEPS * height_m).round().clamp(1.0, 65_535.0) as u16
}

/// The height that a value of `ground.png` stands for; NaN for none.
fn height_of(value: u16) -> f32 {
    match value {
        0 => f32::NAN,
        value => ((f64::from(value) - GROUND_ZERO) / GROUND_STEPS) as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_rounded_and_stay_as_they_were_read() {
        for (height_m, kept_m) in [(0.0249, 0.025), (-0.0024, 0.0), (-1.0026, -1.005)] {
            let value = value_of(height_m);
            assert!((f64::from(height_of(value)) - kept_m).abs() < 1e-6, "{height_m}");
            assert_eq!(value_of(f64::from(height_of(value))), value);
        }
        assert!(height_of(0).is_nan() && !height_of(value_of(-1e4)).is_nan());
    }
}
