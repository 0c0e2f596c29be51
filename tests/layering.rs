//! The picture of the layers (lib.rs): who may use whom, and what the core must not touch.

use std::fs;
use std::path::{Path, PathBuf};

/// Rows from the bottom up; a module may use modules on lower rows only.
const ROWS: &[&[&str]] = &[
    &["geometry", "time"],
    &["protocol", "scan"],
    &["robot", "segmentation"],
    &["mapping", "terrain"],
    &["acquisition", "navigation"],
    &["exploration", "victims"],
    &["mission"],
    &["link", "record", "export"],
    &["config"],
    // Files are read with `config`, and a driver that runs a scenario takes what was read.
    &["files"],
    &["driver"],
    &["cli"],
];

/// The simulator stands apart: sharing the estimator's code would make it agree with its mistakes.
const SIM_MAY_USE: &[&str] = &["protocol", "geometry", "time", "sim"];

/// Rows that are the core: synchronous, deterministic, without a clock or a file.
const CORE_ROWS: usize = 7;

const BANNED_IN_CORE: &[&str] =
    &["tokio", "std::time::Instant", "SystemTime", "std::fs", "HashMap", "HashSet", "std::net"];

fn row_of(module: &str) -> Option<usize> {
    ROWS.iter().position(|row| row.contains(&module))
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

fn all_sources() -> Vec<(String, PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    sources(&root, &mut found);
    found
        .into_iter()
        .map(|path| {
            let relative = path.strip_prefix(&root).unwrap();
            let module = relative.iter().next().unwrap().to_string_lossy();
            let module = module.trim_end_matches(".rs").to_owned();
            let text = fs::read_to_string(&path).unwrap();
            (module, relative.to_path_buf(), text)
        })
        .collect()
}

/// The names after `crate::` in a source text, comments left out; `{a, b::c}` groups are taken apart.
fn crate_uses(text: &str) -> Vec<String> {
    let code: String = text
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .collect::<Vec<_>>()
        .join("\n");
    let mut names = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        if let Some(group) = rest.strip_prefix('{') {
            let mut depth = 1;
            let mut name = String::new();
            let mut at_start = true;
            for c in group.chars() {
                match c {
                    '{' => depth += 1,
                    '}' => depth -= 1,
                    ',' if depth == 1 => at_start = true,
                    c if depth == 1 && at_start && (c.is_alphanumeric() || c == '_') => {
                        name.push(c);
                        continue;
                    }
                    _ => {}
                }
                if !name.is_empty() {
                    names.push(std::mem::take(&mut name));
                    at_start = c == ',';
                }
                if depth == 0 {
                    break;
                }
            }
        } else {
            names.push(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
        }
    }
    names
}

#[test]
fn groups_of_uses_are_taken_apart() {
    assert_eq!(crate_uses("use crate::{time::{Span, Stamp}, scan};"), ["time", "scan"]);
    assert_eq!(crate_uses("// crate::cli\nlet x = crate::geometry::f();"), ["geometry"]);
}

#[test]
fn modules_use_lower_rows_only() {
    let mut wrong = Vec::new();
    for (module, path, text) in all_sources() {
        for used in crate_uses(&text) {
            let known = row_of(&used).is_some() || used == "sim";
            if !known || used == module {
                continue;
            }
            let allowed = match (module.as_str(), used.as_str()) {
                ("sim", used) => SIM_MAY_USE.contains(&used),
                // The shell runs the simulator; the core never sees it.
                (user, "sim") => row_of(user).is_none_or(|row| row >= CORE_ROWS),
                (user, used) => row_of(user).is_none_or(|row| row > row_of(used).unwrap()),
            };
            if !allowed {
                wrong.push(format!("{} uses crate::{used}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "uses against the layers:\n{}", wrong.join("\n"));
}

#[test]
fn the_core_has_no_clock_no_files_and_no_hash_order() {
    let mut wrong = Vec::new();
    for (module, path, text) in all_sources() {
        let core = row_of(&module).is_some_and(|row| row < CORE_ROWS)
            || (module == "sim" && !path.starts_with("sim/server") && !path.ends_with("server.rs"));
        if !core {
            continue;
        }
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap_or_default();
            for banned in BANNED_IN_CORE {
                if code.contains(banned) {
                    wrong.push(format!("{}:{}: {banned}", path.display(), number + 1));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "the core must stay pure:\n{}", wrong.join("\n"));
}
