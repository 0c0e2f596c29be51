//! Ground truth reaches nothing that estimates or decides: scoring alone may read it.

use std::fs;
use std::path::{Path, PathBuf};

/// Modules of the core that estimate and decide.
const ESTIMATORS: [&str; 10] = [
    "scan",
    "segmentation",
    "mapping",
    "terrain",
    "acquisition",
    "navigation",
    "exploration",
    "victims",
    "mission",
    "geometry",
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// What a line of code does with the truth: naming the message in order to pass it over
/// (`GroundTruth(_)`) is the one thing allowed.
fn touches_truth(line: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default().replace("GroundTruth(_)", "");
    code.contains("GroundTruth") || code.contains("ScoringTruth")
}

#[test]
fn no_estimator_names_the_truth() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    for module in ESTIMATORS {
        let folder = root.join(module);
        if folder.is_dir() {
            sources(&folder, &mut found);
        }
    }
    // In `robot` the truth has one file of its own, which nothing else of the module uses.
    sources(&root.join("robot"), &mut found);
    found.retain(|path| {
        !["robot/truth.rs", "robot/mod.rs", "robot/tests.rs"].iter().any(|own| path.ends_with(own))
    });
    found.sort();
    let mut wrong = Vec::new();
    for path in found {
        for (number, line) in fs::read_to_string(&path).unwrap().lines().enumerate() {
            if touches_truth(line) {
                wrong.push(format!("{}:{}: {}", path.display(), number + 1, line.trim()));
            }
        }
    }
    assert!(wrong.is_empty(), "the truth is for scoring only:\n{}", wrong.join("\n"));
}

#[test]
fn passing_the_truth_over_is_no_use_of_it() {
    assert!(!touches_truth("Message::GroundTruth(_) => {}"));
    assert!(!touches_truth("// GroundTruth is for scoring"));
    assert!(touches_truth("Message::GroundTruth(truth) => self.pose = truth.pose,"));
    assert!(touches_truth("fn score(truth: &ScoringTruth)"));
}
