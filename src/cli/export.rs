//! `usar export`: one deliverable from a run folder or a session.

use super::files::write_stdout;
use super::say;
use super::series::{Replayed, Series, watched};
use super::session::DONE_WITH_LOSS;
use crate::export::cloud;
use crate::export::run_folder::{Files, map_files};
use crate::export::tum;
use crate::files::pcd::{Encoding, write_pcd};
use crate::files::replace::replace_file;
use crate::mission::Agent;
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The command line names something that cannot be.
const MISUSE: u8 = 2;

/// Side of the cubes that an exported cloud is thinned to, in metres.
const CLOUD_CELL_M: f64 = 0.05;

/// Arguments of `usar export`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  usar export run/ --to pcd -o points.pcd\n  \
                  usar export session.usar --to map-server -o maps/station\n  \
                  usar export run/ --to scans -o scans/")]
pub struct ExportArguments {
    /// Run folder, recording, or text that a client printed
    run: PathBuf,
    /// What is wanted
    #[arg(long, value_enum)]
    to: Deliverable,
    /// Where to; - is standard output. For map-server: the name before .pgm and .yaml; for scans: a folder
    #[arg(short, long, value_name = "PATH", help_heading = "Output")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Deliverable {
    /// The grid as GeoTIFF (not built yet)
    Geotiff,
    /// The grid as PGM and YAML
    MapServer,
    /// The planes as polygons
    Ply,
    /// The points of all scans, thinned to 5 cm
    Pcd,
    /// The map in three dimensions as a picture
    Png3d,
    /// The trajectory
    Tum,
    /// A folder of the scans that made the map, in their order, as `usar map` reads them:
    /// scan_NNN.pcd, odometry.tum with the sensor's way as it was reckoned between them, and, of a run
    /// whose truth is known, truth.tum with its true way
    Scans,
    /// The session as MCAP (not built yet)
    Mcap,
    /// The map as MapInfo interchange (not built yet)
    Mif,
}

impl Deliverable {
    /// The file of a run folder that it is, and the ending of its own.
    fn file(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Ply => Some(("planes.ply", "ply")),
            Self::Png3d => Some(("map3d.png", "png")),
            Self::Tum => Some(("trajectory.tum", "tum")),
            _ => None,
        }
    }
}

/// Runs the verb.
///
/// # Errors
///
/// A run that cannot be read, an output that cannot be written.
pub fn run(arguments: &ExportArguments) -> Result<ExitCode> {
    if let Deliverable::Geotiff | Deliverable::Mcap | Deliverable::Mif = arguments.to {
        let name =
            arguments.to.to_possible_value().map_or_else(String::new, |v| v.get_name().into());
        say::error(format_args!(
            "--to {name} is not built yet; there are map-server, ply, pcd, png3d, tum and scans"
        ));
        return Ok(ExitCode::from(MISUSE));
    }
    if !arguments.run.exists() && arguments.run != Path::new("-") {
        bail!("cannot read {}: no such file or folder", arguments.run.display());
    }
    let mut source = Source { run: &arguments.run, replayed: None, loss: false };
    match (arguments.to, arguments.to.file()) {
        (_, Some((name, ending))) => {
            let bytes = source.file(name)?;
            write(arguments, ending, &bytes)?;
        }
        (Deliverable::Pcd, _) => {
            let agent = source.agent()?;
            let running = agent.running().context("the session never had a robot in service")?;
            let points = cloud::thinned(running.belief().points(), CLOUD_CELL_M);
            if points.is_empty() {
                bail!("no scan in {}: there are no points to export", arguments.run.display());
            }
            write(arguments, "pcd", &cloud::pcd(&points))?;
        }
        (Deliverable::Scans, _) => scans(arguments, &mut source)?,
        _ => map_server(arguments, &mut source)?,
    }
    Ok(if source.loss { ExitCode::from(DONE_WITH_LOSS) } else { ExitCode::SUCCESS })
}

/// Where the files come from: the run folder as it stands, or the session replayed.
struct Source<'a> {
    run: &'a Path,
    replayed: Option<(Box<Agent>, Files)>,
    /// Whether the session is not whole.
    loss: bool,
}

impl Source<'_> {
    fn file(&mut self, name: &str) -> Result<Vec<u8>> {
        let path = self.run.join(name);
        if self.run.is_dir() && path.exists() {
            return std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()));
        }
        let (_, files) = self.replay()?;
        let found = files.iter().find(|(found, _)| *found == name);
        let (_, bytes) = found.context("the session never had a robot in service")?;
        Ok(bytes.clone())
    }

    fn agent(&mut self) -> Result<&Agent> {
        Ok(&self.replay()?.0)
    }

    fn replay(&mut self) -> Result<&(Box<Agent>, Files)> {
        if self.replayed.is_none() {
            let Replayed { agent, name, loss } = watched(self.run, |_| {})?;
            self.loss = loss;
            let files = map_files(&agent, &name);
            self.replayed = Some((Box::new(agent), files));
        }
        self.replayed.as_ref().context("the session was replayed")
    }
}

/// Writes the scans of a session, and the way between them.
fn scans(arguments: &ExportArguments, source: &mut Source<'_>) -> Result<()> {
    let folder = match &arguments.output {
        Some(path) if path == Path::new("-") => {
            bail!("scans are many files: they cannot all go to standard output")
        }
        Some(path) => path.clone(),
        None => PathBuf::from(format!("{}_scans", stem(&arguments.run))),
    };
    let series = Series::read(&arguments.run)?;
    source.loss = series.loss;
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot make {}", folder.display()))?;
    for (number, scan) in series.scans.iter().enumerate() {
        let bytes = write_pcd(scan, Encoding::Binary);
        save(&folder.join(format!("scan_{number:03}.pcd")), &bytes)?;
    }
    save(&folder.join("odometry.tum"), tum::format(&series.way).as_bytes())?;
    match &series.truth {
        Some(way) => save(&folder.join("truth.tum"), tum::format(way).as_bytes()),
        None => Ok(()),
    }
}

fn map_server(arguments: &ExportArguments, source: &mut Source<'_>) -> Result<()> {
    let stem = arguments.output.clone().unwrap_or_else(|| PathBuf::from(stem(&arguments.run)));
    if stem == Path::new("-") {
        bail!("map-server is two files: they cannot both go to standard output");
    }
    let stem = match stem.extension().and_then(|ending| ending.to_str()) {
        Some("pgm" | "yaml") => stem.with_extension(""),
        _ => stem,
    };
    let with = |ending: &str| {
        let mut name = stem.clone().into_os_string();
        name.push(ending);
        PathBuf::from(name)
    };
    let (pgm, yaml) = (with(".pgm"), with(".yaml"));
    let image = pgm.file_name().context("-o names no file")?.to_string_lossy().into_owned();
    let text = String::from_utf8(source.file("map.yaml")?).context("map.yaml is not text")?;
    let text: String = text
        .lines()
        .map(|line| match line.starts_with("image:") {
            true => format!("image: {image}\n"),
            false => format!("{line}\n"),
        })
        .collect();
    save(&pgm, &source.file("map.pgm")?)?;
    save(&yaml, text.as_bytes())
}

fn write(arguments: &ExportArguments, ending: &str, bytes: &[u8]) -> Result<()> {
    match arguments.output.as_deref() {
        Some(path) if path == Path::new("-") => match std::io::stdout().write_all(bytes) {
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            result => result.context("cannot write to standard output"),
        },
        Some(path) => save(path, bytes),
        None => save(Path::new(&format!("{}.{ending}", stem(&arguments.run))), bytes),
    }
}

fn save(path: &Path, bytes: &[u8]) -> Result<()> {
    replace_file(path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    write_stdout(&format!("{}\n", path.display()))
}

/// The name of a run or session, for files made from it.
fn stem(run: &Path) -> String {
    let absolute = run.canonicalize().unwrap_or_else(|_| run.to_owned());
    let name = if absolute.is_dir() { absolute.file_name() } else { absolute.file_stem() };
    name.map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned())
}
