//! A fake server that follows a script, for clients under test: real sockets on port 0, real time,
//! every wait bounded.
//!
//! A script is a text file in `scripts/`, one step a line, `#` begins a comment line:
//!
//! ```text
//! send LINE             sends LINE and CR LF
//! bytes TEXT            sends TEXT as it is; \r \n \t \\ and \xNN are octets
//! cut N LINE            sends the first N octets of LINE and CR LF
//! rest                  sends what `cut` held back
//! expect PATTERN        reads until a line matches: a verb in any case, {Key} that must be there,
//!                       {Key value} that must have this value; other lines are kept in the transcript
//! answer PATTERN => LINE  from here on each such line is answered, while the script waits or expects
//! wait 200ms            lets time pass, answering
//! quiet 200ms           as wait, but any line is a failure
//! stall 200ms           neither reads nor writes; without a time until the client is gone
//! close                 closes the connection; what was sent arrives
//! accept                waits for the next connection
//! clock 100.00 0.20     simulated time and its step; {t2} and {t4} in a LINE stand for it with 2
//!                       and 4 decimals, {p2} for the time one step before
//! tick                  advances the simulated time by its step
//! repeat N … end        runs the steps between N times
//! ```
//!
//! At the end the server waits until the client has closed, so that its last lines are read.

mod agent;
mod hazards;
mod runner;
mod script;
mod sessions;

pub use runner::{ScriptedServer, Transcript};
pub use script::Script;
