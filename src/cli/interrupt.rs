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
    #[cfg(unix)]
    let terminated = async {
        use tokio::signal::unix::{SignalKind, signal};
        match signal(SignalKind::terminate()) {
            Ok(mut signals) => {
                signals.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    };
    #[cfg(not(unix))]
    let terminated = std::future::pending();
    let interrupted = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        () = interrupted => {}
        () = terminated => {}
    }
    tokio::spawn(async {
        if tokio::signal::ctrl_c().await.is_ok() {
            std::process::exit(130);
        }
    });
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

/// Turns a request to stop into the event that ends a run well.
pub async fn forward(sender: mpsc::Sender<(Arrival, Event)>, clock: SessionClock) {
    asked_to_stop().await;
    let end = (clock.now(), Event::End("interrupted".into()));
    // Nobody listens any more: the run has ended on its own.
    let _ = sender.send(end).await;
}
