//! Run folders on disk: where they go, what is written when.

use crate::files::replace::replace_file;
use anyhow::{Context, Result, bail};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Where a run leaves its files.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// The folder `out`, or `runs/<date>_<name>/` with `runs/latest` pointing to it.
    ///
    /// # Errors
    ///
    /// When it cannot be made, or already holds a recording and `force` is not set.
    pub fn create(out: Option<&Path>, name: &str, force: bool) -> Result<Self> {
        let path = match out {
            Some(path) => path.to_owned(),
            None => PathBuf::from("runs").join(format!("{}_{name}", date())),
        };
        Self::check(Some(&path), force)?;
        std::fs::create_dir_all(&path)
            .with_context(|| format!("cannot make the folder {}", path.display()))?;
        if out.is_none() {
            point_latest_at(&path);
        }
        Ok(Self { path })
    }

    /// Whether a run may write into the folder `out`.
    ///
    /// # Errors
    ///
    /// When it already holds a recording and `force` is not set.
    pub fn check(out: Option<&Path>, force: bool) -> Result<()> {
        match out {
            Some(path) if path.join("session.usar").exists() && !force => bail!(
                "{} holds a recording; a recording is never overwritten without --force",
                path.display()
            ),
            _ => Ok(()),
        }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens the recording for writing.
    ///
    /// # Errors
    ///
    /// When it cannot be made.
    pub fn recording(&self) -> Result<BufWriter<File>> {
        let path = self.path.join("session.usar");
        let file =
            File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(BufWriter::new(file))
    }

    /// Writes one file whole.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path.join(name);
        replace_file(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
    }
}

/// `runs/latest` is a convenience: where it cannot be made, the run goes on without it.
fn point_latest_at(path: &Path) {
    #[cfg(unix)]
    {
        let link = Path::new("runs/latest");
        let _ = std::fs::remove_file(link);
        if let Some(name) = path.file_name() {
            let _ = std::os::unix::fs::symlink(name, link);
        }
    }
}

/// The date and time in UTC as `YYYY-MM-DD_HH-MM-SS`, by the civil calendar.
fn date() -> String {
    #[expect(clippy::disallowed_methods, reason = "the name of a run folder is a wall date")]
    let now = SystemTime::now();
    let seconds = now.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Days to year, month, day: the era-based conversion for the proleptic Gregorian calendar.
    let z = days + 719_468;
    let era = z / 146_097;
    let day_of_era = z % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}_{:02}-{:02}-{:02}",
        rest / 3_600,
        rest % 3_600 / 60,
        rest % 60
    )
}
