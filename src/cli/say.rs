//! What goes to standard error: how much of it, and whether in colour.

use clap::{ArgAction, Args, ValueEnum};
use std::fmt::Display;
use std::io::{IsTerminal as _, Write as _};
use std::sync::atomic::{AtomicBool, AtomicI8, Ordering};

/// How much is said: below 0 errors alone, 0 as usual, above it more. It is a matter of the process,
/// as standard error is, and set once, before a verb runs.
static LOUDNESS: AtomicI8 = AtomicI8::new(0);
static COLOUR: AtomicBool = AtomicBool::new(false);

/// Options that every verb has.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Messages")]
pub struct Manners {
    /// Say more on standard error: what the agent does, what a server hears
    #[arg(short, long, action = ArgAction::Count, global = true, conflicts_with = "quiet")]
    verbose: u8,
    /// Say nothing but errors on standard error
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Whether messages are coloured; NO_COLOR means never where it is left to the program
    #[arg(long, value_enum, value_name = "WHEN", default_value_t, global = true)]
    color: When,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum When {
    /// In a terminal
    #[default]
    Auto,
    /// Always
    Always,
    /// Never
    Never,
}

impl Manners {
    /// Makes them those of the process.
    pub fn set(self) {
        let loudness = if self.quiet { -1 } else { i8::try_from(self.verbose).unwrap_or(i8::MAX) };
        LOUDNESS.store(loudness, Ordering::Relaxed);
        let wanted = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        let colour = match self.color {
            When::Auto => wanted && std::io::stderr().is_terminal(),
            When::Always => true,
            When::Never => false,
        };
        COLOUR.store(colour, Ordering::Relaxed);
    }
}

/// How much is to be said.
pub fn loudness() -> i8 {
    LOUDNESS.load(Ordering::Relaxed)
}

/// Whether messages are coloured.
pub fn is_coloured() -> bool {
    COLOUR.load(Ordering::Relaxed)
}

/// Lets what the library logs go to standard error: from `usual` on, or as `-q`, `-v` and `RUST_LOG` say.
pub fn log(usual: &str) {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| {
        tracing_subscriber::EnvFilter::new(match loudness() {
            ..0 => "error",
            0 => usual,
            1 => "debug",
            2.. => "trace",
        })
    });
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // A terminal that has gone must not end a server: what cannot be logged is lost.
    let log = log.with_ansi(is_coloured()).log_internal_errors(false);
    // Where a log is set up already, that one serves.
    let _ = log.without_time().with_target(false).try_init();
}

/// What ended a verb, or one of its parts. A terminal that has gone ends nothing, as `eprintln!` would.
pub fn error(text: impl Display) {
    labelled("error:", "31", &text);
}

/// Carried on, but not as told.
pub fn warn(text: impl Display) {
    if loudness() >= 0 {
        labelled("warning:", "33", &text);
    }
}

/// What is going on.
pub fn tell(text: impl Display) {
    if loudness() >= 0 {
        let _ = writeln!(std::io::stderr(), "{text}");
    }
}

fn labelled(label: &str, colour: &str, text: &dyn Display) {
    let _ = match is_coloured() {
        true => writeln!(std::io::stderr(), "\x1b[1;{colour}m{label}\x1b[0m {text}"),
        false => writeln!(std::io::stderr(), "{label} {text}"),
    };
}
