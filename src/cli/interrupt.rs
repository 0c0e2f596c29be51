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

/// Watches for Ctrl-C on a thread of its own. Where no signal can be watched, Ctrl-C ends the
/// program at once, as it would without us.
pub fn watch() -> Interrupt {
    let interrupt = Interrupt::default();
    let flag = interrupt.clone();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let Ok(runtime) = runtime else { return };
        runtime.block_on(async move {
            if tokio::signal::ctrl_c().await.is_err() {
                return;
            }
            flag.0.store(true, Ordering::Relaxed);
            if tokio::signal::ctrl_c().await.is_ok() {
                std::process::exit(130);
            }
        });
    });
    interrupt
}

/// Turns signals into the request to end: the first Ctrl-C or a request to terminate ends the run
/// well, the second Ctrl-C ends the program at once.
pub async fn forward(sender: mpsc::Sender<(Arrival, Event)>, clock: SessionClock) {
    asked_to_end().await;
    let end = (clock.now(), Event::End("interrupted".into()));
    if sender.send(end).await.is_err() {
        return;
    }
    if tokio::signal::ctrl_c().await.is_ok() {
        std::process::exit(130);
    }
}

#[cfg(unix)]
async fn asked_to_end() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            }
        }
        Err(_) => drop(tokio::signal::ctrl_c().await),
    }
}

#[cfg(not(unix))]
async fn asked_to_end() {
    drop(tokio::signal::ctrl_c().await);
}
