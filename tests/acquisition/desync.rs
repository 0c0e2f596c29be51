//! What lines, tilts and poses that are not of one time do to the planes of a continuous scan.

use super::bench::{Bench, Setting};
use super::planes::{PlaneErrors, lines_of, plane_errors, truth_of};
use nalgebra::Point2;
use usar_agent::acquisition::{
    AcquisitionConfig, RecordedTriples, SweepRequest, TiltMount, Triple, scan_by_request,
};
use usar_agent::export::canvas::{Canvas, Colour};
use usar_agent::protocol::Dialect;
use usar_agent::scan::RangeImage;
use usar_agent::time::{Span, Stamp};

/// A continuous scan of `station` by 0.05 rad/s as a record of triples, with the truth of its rows.
fn recorded() -> (Bench, RecordedTriples, RangeImage) {
    let setting = Setting { scenario: "station", ..Setting::new(Dialect::Ut2004, true) };
    let mut bench = Bench::new(&setting, AcquisitionConfig::default());
    bench.calibrate();
    bench.take(SweepRequest::continuous());
    let scan = bench.take(SweepRequest::continuous());
    let lines = lines_of(&scan.image);
    let truth = truth_of(&bench, &scan.image, &lines);
    let triples = scan.image.rows().iter().zip(lines).map(|(row, mut line)| {
        let cast = bench.cast_of(row).unwrap();
        line.stamp = cast.cast_at;
        Triple {
            stamp: cast.cast_at,
            frame_from_robot: bench.frame_from_robot,
            tilt_rad: row.tilt_rad,
            line,
        }
    });
    let record = RecordedTriples::new(triples.collect());
    // By way of its text: what is replayed is what a file holds.
    let record = RecordedTriples::parse(&record.to_text()).unwrap();
    (bench, record, truth)
}

fn errors_at(
    late: Span,
    (bench, record, truth): &(Bench, RecordedTriples, RangeImage),
) -> PlaneErrors {
    let mount = TiltMount::of(&bench.rig.laser.as_ref().unwrap().head).unwrap();
    let mut source = record.clone().desynchronised(late, Span::ZERO);
    let every_line = (Stamp(i64::MIN / 2), Span::ZERO, record.triples().len());
    let image = scan_by_request(&mut source, every_line, &mount).unwrap();
    plane_errors(&image, truth)
}

#[test]
fn a_recorded_continuous_scan_is_as_good_as_live_and_suffers_by_speed_times_delay() {
    let case = recorded();
    let in_time = errors_at(Span::ZERO, &case);
    assert!(in_time.planes >= 3, "{in_time:?}");
    assert!(in_time.tilt_rad.to_degrees() < 0.1, "{in_time:?}");
    // 0.05 rad/s for 0.2 s is 0.57°.
    let late = errors_at(Span::from_millis(200), &case);
    let degrees = late.tilt_rad.to_degrees();
    assert!((0.3..0.9).contains(&degrees), "{degrees}°");
}

/// Draws src/guide/desync.png: `tests/campaign/desync.sh`.
#[test]
#[ignore = "draws a picture: tests/campaign/desync.sh"]
fn plot() {
    let case = recorded();
    // Beyond, surfaces are cut up differently and their planes are no longer the same ones.
    let millis = (-8..=8).map(|i| 50 * i64::from(i));
    let curve: Vec<(f64, PlaneErrors)> =
        millis.map(|ms| (ms as f64, errors_at(Span::from_millis(ms), &case))).collect();
    println!("tilt late, ms | planes | offset mm | tilt °");
    for (ms, errors) in &curve {
        println!(
            "{ms:>13} | {:>6} | {:>9.1} | {:.3}",
            errors.planes,
            1e3 * errors.offset_m,
            errors.tilt_rad.to_degrees()
        );
    }
    std::fs::write("src/guide/desync.png", picture(&curve).to_png()).unwrap();
}

fn picture(curve: &[(f64, PlaneErrors)]) -> Canvas {
    const GREY: Colour = Colour::rgb(200, 200, 200);
    const BLUE: Colour = Colour::rgb(30, 80, 200);
    const RED: Colour = Colour::rgb(200, 50, 30);
    // Twice the size, then halved: smooth lines.
    let (width, height) = (1400.0, 840.0);
    let (left, right, top, bottom) = (130.0, 130.0, 90.0, 120.0);
    let mut canvas = Canvas::new(width as usize, height as usize, Colour::WHITE);
    let most_deg = curve.iter().map(|c| c.1.tilt_rad.to_degrees()).fold(0.5, f64::max).ceil();
    let most_mm =
        (curve.iter().map(|c| 1e3 * c.1.offset_m).fold(10.0, f64::max) / 50.0).ceil() * 50.0;
    let x = |ms: f64| left + (ms + 400.0) / 800.0 * (width - left - right);
    let y = |share: f64| height - bottom - share * (height - top - bottom);
    for i in 0..=4 {
        let share = f64::from(i) / 4.0;
        canvas.line(Point2::new(left, y(share)), Point2::new(width - right, y(share)), 2.0, GREY);
        let degrees = format!("{:.2}", share * most_deg);
        canvas.text(20.0, y(share) - 10.0, 3, &degrees, BLUE);
        canvas.text(width - 110.0, y(share) - 10.0, 3, &format!("{:.0}", share * most_mm), RED);
    }
    for ms in (-400..=400).step_by(200) {
        let at = x(f64::from(ms));
        canvas.line(Point2::new(at, y(0.0)), Point2::new(at, y(1.0)), 2.0, GREY);
        canvas.text(at - 30.0, height - 105.0, 3, &ms.to_string(), Colour::BLACK);
    }
    let line = |value: &dyn Fn(&PlaneErrors) -> f64| -> Vec<Point2<f64>> {
        curve.iter().map(|(ms, errors)| Point2::new(x(*ms), y(value(errors)))).collect()
    };
    canvas.polyline(&line(&|e| e.tilt_rad.to_degrees() / most_deg), 5.0, BLUE);
    canvas.polyline(&line(&|e| 1e3 * e.offset_m / most_mm), 5.0, RED);
    canvas.text(left, 20.0, 3, "plane tilt error, degrees", BLUE);
    let offset = "plane offset error, mm";
    canvas.text(width - right - Canvas::text_width(3, offset), 20.0, 3, offset, RED);
    let below = "tilt readings later than laser lines, ms (0.05 rad/s, station)";
    canvas.text(left, height - 55.0, 3, below, Colour::BLACK);
    canvas.halved()
}
