//! Ctrl-C: the first asks a run to end well, the second ends the program.

use crate::link::SessionClock;
use crate::mission::Event;
use crate::time::Arrival;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::mpsc;

/// Whether Ctrl-C was pressed.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Whether the run is to end.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Done when the program is asked to end, by Ctrl-C or by the system; a second Ctrl-C ends it at once.
/// Where no signal can be watched it is never done, and Ctrl-C ends the program as it would without
/// us.
pub async fn asked_to_stop() {
    told_to_end().await;
    tokio::spawn(async {
        if tokio::signal::ctrl_c().await.is_ok() {
            std::process::exit(130);
        }
    });
}

/// Done at Ctrl-C, or when the system asks the program to end.
async fn told_to_end() {
    let interrupted = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        () = interrupted => {}
        () = terminated() => {}
    }
}

/// Done at SIGTERM, and when the terminal is closed unless that was to be ignored, as `nohup` has it.
#[cfg(unix)]
async fn terminated() {
    use tokio::signal::unix::{SignalKind, signal};
    let sent = |kind: SignalKind| async move {
        match signal(kind) {
            Ok(mut signals) => {
                signals.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    };
    let hung_up = async {
        if hangup_is_ignored() {
            std::future::pending::<()>().await;
        }
        sent(SignalKind::hangup()).await;
    };
    tokio::select! {
        () = sent(SignalKind::terminate()) => {}
        () = hung_up => {}
    }
}

#[cfg(not(unix))]
async fn terminated() {
    std::future::pending().await
}

/// Whether whoever started the program had SIGHUP, signal 1, ignored. Where that cannot be known it
/// was not.
#[cfg(unix)]
pub fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 != 0)
}

/// Watches for Ctrl-C on a thread of its own, and for the system asking the program to end. Where no
/// signal can be watched, Ctrl-C ends the program at once, as it would without us.
pub fn watch() -> Interrupt {
    let interrupt = Interrupt::default();
    let flag = interrupt.clone();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let Ok(runtime) = runtime else { return };
        runtime.block_on(async move {
            told_to_end().await;
            flag.0.store(true, Ordering::Relaxed);
            if tokio::signal::ctrl_c().await.is_ok() {
                std::process::exit(130);
            }
        });
    });
    interrupt
}

/// Turns a request to stop into the event that ends a run well.
pub async fn forward(sender: mpsc::Sender<(Arrival, Event)>, clock: SessionClock) {
    asked_to_stop().await;
    let end = (clock.now(), Event::End("interrupted".into()));
    // Nobody listens any more: the run has ended on its own.
    let _ = sender.send(end).await;
}
