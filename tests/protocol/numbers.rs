//! Ranges of a laser line beside the standard parser.

use usar_agent::protocol::message::Sen;
use usar_agent::protocol::{Message, parse};

fn ranges(texts: &[String]) -> Vec<f64> {
    let line = format!("SEN {{Type RangeScanner}} {{Name S}} {{Range {}}}", texts.join(","));
    match parse(line.as_bytes()).message {
        Message::Sen(Sen::RangeScanner(scan)) => scan.ranges_m,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_range_that_servers_can_write_has_the_bits_of_the_standard_parser() {
    // UT2004 up to 99.9999 m, UDK up to 999.99 m, and the way to the world's origin below both.
    for (count, decimals, scale) in [(1_000_000, 4, 1e4), (100_000, 2, 1e2), (1000, 0, 1.0)] {
        for block in (0..count).step_by(1000) {
            let text = |number: i32| format!("{:.decimals$}", f64::from(number) / scale);
            let texts: Vec<String> = (block..block + 1000).map(text).collect();
            let standard = texts.iter().map(|text| text.parse::<f64>().unwrap().to_bits());
            assert!(ranges(&texts).into_iter().map(f64::to_bits).eq(standard), "from {block}");
        }
    }
}
