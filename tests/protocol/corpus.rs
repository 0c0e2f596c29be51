//! The fuzz targets' corpus, run as ordinary tests: seeds for every hazard of the reference, and
//! what fuzzing found.

#[path = "../fuzz/invariants.rs"]
mod invariants;

use std::path::Path;

fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(target);
    let files = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let inputs: Vec<_> = files.map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    assert!(inputs.len() >= 20, "{} holds {} inputs", folder.display(), inputs.len());
    inputs
}

#[test]
fn every_line_of_the_corpus_keeps_the_invariants() {
    for input in corpus("parse_line") {
        invariants::line(&input);
    }
}

#[test]
fn every_stream_of_the_corpus_keeps_the_invariants() {
    for input in corpus("parse_stream") {
        invariants::stream(&input);
    }
}

#[test]
fn a_line_of_braces_alone_costs_no_more_than_its_length() {
    for text in ["{", "}", "{}", "{ID}", "{Name a b c}", "{Link 1}", "{StartPoses 1}"] {
        let head = ["SEN {Type RFID} ", "NFO {StartPoses 1} ", "CONF {Type MisPkg} ", "DRIVE "];
        for head in head {
            let line = format!("{head}{}", text.repeat(200_000 / text.len()));
            invariants::line(line.as_bytes());
        }
    }
}
