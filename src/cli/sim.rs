//! `usar sim`: the stand-in USARSim server on TCP.

use super::files::write_stdout;
use super::say;
use crate::files::scenario;
use crate::protocol::Dialect;
use crate::sim::Session;
use crate::sim::server::{ImageType, Server, ServerError, listen};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitCode;
use tokio::net::TcpListener;

/// Arguments of `usar sim`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  usar sim station\n  \
                        usar sim scenarios/yellow.toml --port 0 --dialect udk\n\n\
                        Prints `listening on ADDR:PORT` first. Ctrl-C ends it.")]
pub struct SimArguments {
    /// Scenario file, or the name of one in the program: box, planes, station, station_udk, yellow
    scenario: PathBuf,
    /// Port of the robots' connections; 0 picks a free one
    #[arg(long, value_name = "PORT", default_value_t = 3000)]
    port: u16,
    /// Port of the camera image server; 0 picks a free one [default: 5003, or a free one if that is
    /// taken]
    #[arg(long, value_name = "PORT")]
    image_port: Option<u16>,
    /// Port of the monitor interface for a wireless simulation; 0 picks a free one [default: 7435, or
    /// none if that is taken]
    #[arg(long, value_name = "PORT")]
    monitor_port: Option<u16>,
    /// Port of the truth server (UDK); 0 picks a free one [default: 3989, or none if that is taken]
    #[arg(long, value_name = "PORT")]
    truth_port: Option<u16>,
    /// How pictures are sent [default: good for ut2004, raw for udk]
    #[arg(long, value_enum)]
    image_type: Option<ImageTypeArgument>,
    /// Address to listen on
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1")]
    bind: IpAddr,
    /// Which server is stood in for, instead of the scenario's
    #[arg(long, value_enum)]
    dialect: Option<DialectArgument>,
    /// Level time per wall time
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = factor)]
    speed: f64,
    /// Seed of the noise, instead of the scenario's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DialectArgument {
    /// Unreal Engine 2, USARSim 2.x to 3.x
    Ut2004,
    /// Unreal Engine 3
    Udk,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ImageTypeArgument {
    /// Pixels
    Raw,
    /// JPEG of the highest quality
    Superb,
    /// JPEG of good quality
    Good,
    /// JPEG of normal quality
    Normal,
    /// JPEG of average quality
    Fair,
    /// JPEG of bad quality
    Bad,
}

impl From<ImageTypeArgument> for ImageType {
    fn from(argument: ImageTypeArgument) -> Self {
        match argument {
            ImageTypeArgument::Raw => Self::Raw,
            ImageTypeArgument::Superb => Self::Superb,
            ImageTypeArgument::Good => Self::Good,
            ImageTypeArgument::Normal => Self::Normal,
            ImageTypeArgument::Fair => Self::Fair,
            ImageTypeArgument::Bad => Self::Bad,
        }
    }
}

/// The socket of the image server. The usual port may be another simulator's; one that was asked for
/// may not.
async fn listen_for_viewers(arguments: &SimArguments) -> Result<TcpListener, ServerError> {
    const USUAL: u16 = 5003;
    let at = |port| SocketAddr::new(arguments.bind, port);
    match (arguments.image_port, listen(at(arguments.image_port.unwrap_or(USUAL))).await) {
        (None, Err(error)) => {
            tracing::warn!("{error}; a free one is taken for pictures");
            listen(at(0)).await
        }
        (_, listener) => listener,
    }
}

/// The socket of a service that few ask for, likewise; without its usual port there is none.
async fn listen_for(
    service: &str,
    at: IpAddr,
    asked: Option<u16>,
    usual: u16,
) -> Result<Option<TcpListener>, ServerError> {
    match (asked, listen(SocketAddr::new(at, asked.unwrap_or(usual))).await) {
        (None, Err(error)) => {
            tracing::warn!("{error}; no {service}");
            Ok(None)
        }
        (_, listener) => listener.map(Some),
    }
}

/// A speed of level time.
fn factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(factor) if factor > 0.0 && factor <= 1000.0 => Ok(factor),
        _ => Err("expected a number above 0, at most 1000".to_owned()),
    }
}

/// Runs the verb until Ctrl-C.
///
/// # Errors
///
/// A scenario that cannot be used, a port that is taken.
pub fn run(arguments: &SimArguments) -> Result<ExitCode> {
    // Who connects and what is refused.
    say::log("info");
    // With the agent's part, which the server does not need: a scenario is valid or not, whoever asks.
    let mut files = scenario::load(&arguments.scenario, &[])?.files;
    if let Some(dialect) = arguments.dialect {
        files.scenario.dialect = match dialect {
            DialectArgument::Ut2004 => Dialect::Ut2004,
            DialectArgument::Udk => Dialect::Udk,
        };
    }
    if let Some(seed) = arguments.seed {
        files.scenario.seed = seed;
    }
    let session = Session::new(&files.world, &files.scenario, &files.catalogue)
        .with_context(|| arguments.scenario.display().to_string())?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("cannot start the server's threads")?;
    runtime.block_on(async {
        let listener = listen(SocketAddr::new(arguments.bind, arguments.port)).await?;
        let viewers = listen_for_viewers(arguments).await?;
        let (bind, monitor_port) = (arguments.bind, arguments.monitor_port);
        let mut services =
            vec![("monitor", listen_for("monitor", bind, monitor_port, 7435).await?)];
        if session.dialect() == Dialect::Udk {
            services.push(("truth", listen_for("truth", bind, arguments.truth_port, 3989).await?));
        }
        let (address, image_address) = (listener.local_addr()?, viewers.local_addr()?);
        let mut text = format!("listening on {address}\nimages on {image_address}\n");
        for (service, listener) in &services {
            if let Some(listener) = listener {
                text.push_str(&format!("{service} on {}\n", listener.local_addr()?));
            }
        }
        write_stdout(&text)?;
        let usual = ImageType::usual(session.dialect());
        let image_type = arguments.image_type.map_or(usual, ImageType::from);
        let mut server =
            Server::new(session, listener, arguments.speed).with_images(viewers, image_type);
        for listener in services.into_iter().filter_map(|(_, listener)| listener) {
            server = server.with_monitor(listener);
        }
        server.run(super::interrupt::asked_to_stop()).await;
        Ok(ExitCode::SUCCESS)
    })
}
