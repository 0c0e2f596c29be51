//! The operator's keys in a terminal.
//!
//! A terminal tells when a key is pressed and, while it is held, that it repeats; it does not tell
//! when it is let go. So each press is one drive command, whose lease the core ends 300 ms later: a
//! held key drives on, a released one stops.

use crate::link::SessionClock;
use crate::mission::{Event, Mode, OperatorEvent};
use crate::time::Arrival;
use crossterm::event::{Event as TerminalEvent, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use crossterm::{event, terminal};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Duration;
use tokio::sync::mpsc;

/// Where acts of the operator go.
pub type Sender = mpsc::Sender<(Arrival, Event)>;

/// What the keys do.
pub const HELP: &str = "keys: w a s d or arrows drive while held, q e curve, space stops, \
                        + - speed, r scans here, 1 auto 2 shared 3 teleop, x ends";

/// How often the reading thread looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);

/// Speeds at full: m/s and rad/s; the pilot lowers them to what the robot can do.
const FULL: (f64, f64) = (0.7, 0.8);

/// How long the reading thread may take to end. One that reads from a terminal that was closed never
/// does; it ends with the program.
const PATIENCE: Duration = Duration::from_millis(500);

/// Keys being read; the terminal is put back when this is dropped.
#[derive(Debug)]
pub struct Keyboard {
    done: Arc<AtomicBool>,
    /// Closed when the reading thread ends.
    ended: Receiver<()>,
}

impl Keyboard {
    /// Puts the terminal into raw mode and sends what the keys mean.
    ///
    /// # Errors
    ///
    /// When the terminal does not allow it.
    pub fn open(sender: Sender, clock: SessionClock) -> io::Result<Self> {
        terminal::enable_raw_mode()?;
        let done = Arc::new(AtomicBool::new(false));
        let flag = done.clone();
        let (alive, ended) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let _alive = alive;
            read(&sender, clock, &flag);
        });
        Ok(Self { done, ended })
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        let _ = self.ended.recv_timeout(PATIENCE);
        let _ = terminal::disable_raw_mode();
    }
}

fn read(sender: &Sender, clock: SessionClock, done: &AtomicBool) {
    let mut speed = Speed::default();
    let mut asked_to_end = false;
    while !done.load(Ordering::Relaxed) {
        if !event::poll(LOOK).unwrap_or(false) {
            continue;
        }
        let Ok(TerminalEvent::Key(key)) = event::read() else { continue };
        if key.kind == KeyEventKind::Release {
            continue;
        }
        // Raw mode hands Ctrl-C over as a key.
        let act = if is_interrupt(&key) {
            if asked_to_end {
                let _ = terminal::disable_raw_mode();
                std::process::exit(130);
            }
            asked_to_end = true;
            Some(Event::End("interrupted".into()))
        } else {
            speed.act(key.code).map(Event::Operator)
        };
        if let Some(event) = act {
            // A full queue means that the agent is busy; the press is worth nothing later.
            let _ = sender.try_send((clock.now(), event));
        }
    }
}

fn is_interrupt(key: &KeyEvent) -> bool {
    key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL)
}

/// The share of full speed that keys command.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Speed {
    share: f64,
}

impl Default for Speed {
    fn default() -> Self {
        Self { share: 0.6 }
    }
}

impl Speed {
    const STEP: f64 = 0.1;

    /// What a key means; `None` for one that means nothing to the agent.
    fn act(&mut self, key: KeyCode) -> Option<OperatorEvent> {
        let key = match key {
            KeyCode::Char(letter) => letter.to_ascii_lowercase(),
            KeyCode::Up => 'w',
            KeyCode::Down => 's',
            KeyCode::Left => 'a',
            KeyCode::Right => 'd',
            KeyCode::Esc => 'x',
            _ => return None,
        };
        let drive = |ahead: f64, left: f64| {
            Some(OperatorEvent::Drive {
                linear_mps: ahead * FULL.0 * self.share,
                angular_rps: left * FULL.1 * self.share,
            })
        };
        match key {
            'w' => drive(1.0, 0.0),
            's' => drive(-1.0, 0.0),
            'a' => drive(0.0, 1.0),
            'd' => drive(0.0, -1.0),
            'q' => drive(1.0, 0.5),
            'e' => drive(1.0, -0.5),
            ' ' => Some(OperatorEvent::Stop),
            'r' => Some(OperatorEvent::ScanNow),
            '1' => Some(OperatorEvent::SetMode(Mode::Auto)),
            '2' => Some(OperatorEvent::SetMode(Mode::Shared)),
            '3' => Some(OperatorEvent::SetMode(Mode::Teleop)),
            'x' => Some(OperatorEvent::Quit),
            '+' | '=' => {
                self.share = (self.share + Self::STEP).min(1.0);
                None
            }
            '-' => {
                self.share = (self.share - Self::STEP).max(Self::STEP);
                None
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_and_arrows_drive_alike_and_left_is_positive() {
        let mut speed = Speed::default();
        assert_eq!(speed.act(KeyCode::Up), speed.act(KeyCode::Char('w')));
        let Some(OperatorEvent::Drive { linear_mps, angular_rps }) = speed.act(KeyCode::Left)
        else {
            panic!("an arrow drives");
        };
        assert!(linear_mps == 0.0 && angular_rps > 0.0);
        assert_eq!(speed.act(KeyCode::Char('z')), None);
    }

    #[test]
    fn speed_stays_within_its_bounds() {
        let mut speed = Speed::default();
        for _ in 0..50 {
            speed.act(KeyCode::Char('+'));
        }
        assert_eq!(speed.share, 1.0);
        for _ in 0..50 {
            speed.act(KeyCode::Char('-'));
        }
        assert!((speed.share - Speed::STEP).abs() < 1e-9);
    }
}
