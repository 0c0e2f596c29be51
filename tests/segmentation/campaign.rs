//! Many random scenes, noises and geometries: a table, on demand.
//!
//! `cargo test --release -- --ignored segmentation_campaign --nocapture`; the environment variables
//! `SCENES` (number, default 12), `METHOD` and `GEOMETRY` narrow it.

use super::scanner::{Noise, Scan, Scanner, scan};
use super::scenes::scene;
use super::score::{Score, components, score};
use super::world::{Kind, Random, World};
use usar_agent::segmentation::{Segmentation, SegmentationConfig, Segmenter, Shape};

/// Score of one result with the number of surfaces that were also typed right.
pub fn judge(scan: &Scan, world: &World, result: &Segmentation) -> (Score, usize) {
    let columns = scan.scanner.columns;
    let truth = components(&scan.truth, columns, 0);
    let labels: Vec<usize> = result.labels.iter().map(|&l| usize::from(l)).collect();
    let found = components(&labels, columns, 40);
    let score = score(&truth, &found, 40);
    let typed = score
        .pairs
        .iter()
        .filter(|&&(t, f)| {
            let cell = (0..truth.len()).find(|&i| truth[i] == t && found[i] == f).unwrap();
            let shape = &result.surfaces[labels[cell] - 1].shape;
            let kind = match shape {
                Shape::Plane(_) => Some(Kind::Plane),
                Shape::Cylinder(_) => Some(Kind::Cylinder),
                Shape::Sphere(_) => Some(Kind::Sphere),
                Shape::Other => None,
            };
            kind == Some(world.solids[scan.truth[cell] - 1].kind())
        })
        .count();
    (score, typed)
}

fn world_kind(world: &World, id: usize) -> Kind {
    world.solids[id - 1].kind()
}

pub fn geometries() -> Vec<(&'static str, Scanner)> {
    let paper = Scanner::paper();
    vec![
        ("paper 220x131", paper.clone()),
        ("flipped, transposed", paper.reordered(true, false, true)),
        ("70x131 of 0.79°", Scanner::nodding(70, 131, [-25.0, 30.0], [65.0, -65.0], [0.0, 0.0])),
        ("lever 0.1 m", Scanner::nodding(220, 131, [-25.0, 29.75], [65.0, -65.0], [0.1, 0.05])),
        ("220x261 of 0.5°", Scanner::nodding(220, 261, [-25.0, 29.75], [65.0, -65.0], [0.0, 0.0])),
        ("pinhole 240x320", Scanner::pinhole(240, 320, 260.0)),
    ]
}

#[test]
#[ignore = "a campaign: minutes, and its result is a table"]
fn segmentation_campaign() {
    let variable = |name: &str| std::env::var(name).ok();
    let scenes: u64 = variable("SCENES").and_then(|s| s.parse().ok()).unwrap_or(12);
    let wanted = variable("GEOMETRY").unwrap_or_default();
    println!(
        "{:<22} {:>5} | {:>9} | correct/all  typed  over under missed noise",
        "geometry", "mm", "oracle"
    );
    for (name, scanner) in geometries() {
        if !name.contains(&wanted) {
            continue;
        }
        for sigma_mm in [1.0, 5.0, 10.0, 20.0, 30.0] {
            let mut segmenter = Segmenter::new(SegmentationConfig::default());
            let (mut ours, mut oracle, mut typed_sum) = (Score::default(), Score::default(), 0);
            for index in 0..scenes {
                let scene = scene(index);
                let noise = Noise::of(sigma_mm * 1e-3);
                let mut random = Random(index * 1000 + sigma_mm as u64);
                let scan = scan(&scene.world, &scene.pose, &scanner, noise, &mut random);
                let result = segmenter.segment(&scan.grid);
                if let Some(folder) = variable("DUMP") {
                    let path = format!("{folder}/{index}_{sigma_mm}.pcd");
                    let bytes = usar_agent::files::pcd::write_pcd(
                        &scan.grid,
                        usar_agent::files::pcd::Encoding::Binary,
                    );
                    std::fs::write(&path, bytes).unwrap();
                    let truth: Vec<u8> =
                        scan.truth.iter().flat_map(|&t| (t as u16).to_le_bytes()).collect();
                    std::fs::write(path.replace(".pcd", ".u16"), truth).unwrap();
                }
                let (judged, typed) = judge(&scan, &scene.world, result);
                let columns = scanner.columns;
                let best = components(&scan.oracle(&scene.world), columns, 40);
                oracle.add(&score(&components(&scan.truth, columns, 0), &best, 40));
                ours.add(&judged);
                typed_sum += typed;
                if variable("VERBOSE").is_some() {
                    let truth = components(&scan.truth, columns, 0);
                    let mut regions: std::collections::BTreeMap<usize, (usize, usize)> =
                        Default::default();
                    for (&t, &s) in truth.iter().zip(&scan.truth) {
                        let entry = regions.entry(t).or_insert((0, s));
                        entry.0 += 1;
                    }
                    for (t, (size, s)) in regions {
                        if t > 0 && size >= 40 && !judged.pairs.iter().any(|p| p.0 == t) {
                            let mut found: std::collections::BTreeMap<u16, usize> =
                                Default::default();
                            for (i, _) in truth.iter().enumerate().filter(|x| *x.1 == t) {
                                *found.entry(result.labels[i]).or_default() += 1;
                            }
                            let cell = truth.iter().position(|&x| x == t).unwrap();
                            println!(
                                "        lost {:?} {size} at {},{}: {found:?}",
                                world_kind(&scene.world, s),
                                cell / columns,
                                cell % columns
                            );
                        }
                    }
                    println!(
                        "    {index} {}: {}/{} typed {typed} over {} under {} missed {} noise {}",
                        scene.name,
                        judged.correct,
                        judged.truths,
                        judged.over,
                        judged.under,
                        judged.missed,
                        judged.noise
                    );
                }
            }
            println!(
                "{name:<22} {sigma_mm:>5} | {:>4}/{:<4} | {:>4}/{:<4} {:>5}   {:>4} {:>5} {:>6} {:>5}",
                oracle.correct,
                oracle.truths,
                ours.correct,
                ours.truths,
                typed_sum,
                ours.over,
                ours.under,
                ours.missed,
                ours.noise
            );
        }
    }
}
