//! The protocol from outside: the reference's own lines, a recording, properties, a fuzz corpus.

mod corpus;
mod numbers;
mod properties;
mod recording;
mod strategies;
mod vectors;

use std::path::{Path, PathBuf};

/// A file of the reference data, or `None` with a printed line where the data is absent.
pub fn reference_data(name: &str) -> Option<Vec<u8>> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let folder = std::env::var_os("USAR_REFERENCE_DATA").map_or_else(default, PathBuf::from);
    let found = std::fs::read(folder.join(name));
    if found.is_err() {
        println!("skipped: needs {name} in {}", folder.display());
    }
    found.ok()
}
