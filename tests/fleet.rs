//! Eight robots in one world: nobody is forgotten, nothing grows. A binary of its own with one
//! test, as the system counts the memory of a whole process.
//!
//! Two minutes of level time in the ordinary test; `tests/campaign/fleet.sh` asks for thirty.

use std::path::Path;
use usar_agent::files::world::load_world;
use usar_agent::sim::{Noise, Session};
use usar_agent::time::Span;

/// Where the robots are put, on the station's floor: wire x, y and yaw.
const PLACES: [[f64; 3]; 8] = [
    [-12.4, -0.2, 0.0],
    [-6.4, -5.0, 0.0],
    [9.5, 3.2, 3.1],
    [-11.4, 8.6, -1.57],
    [-18.2, 8.0, -0.8],
    [-14.0, -0.2, 3.1],
    [-4.6, -5.0, 0.0],
    [7.5, 3.2, 3.1],
];

/// Octets of memory that the process has in use; `None` where the system does not tell.
fn resident() -> Option<i64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(text.split(' ').nth(1)?.parse::<i64>().ok()? * 4096)
}

#[test]
fn eight_robots_keep_talking_and_memory_stays_flat() {
    let minutes: u32 = std::env::var("USAR_FLEET_MINUTES").map_or(2, |text| text.parse().unwrap());
    let mut files = load_world(Path::new("station")).unwrap();
    // Nobody runs dry on the way.
    files.scenario.robots[0].battery_s = Some(1e6);
    let mut session = Session::new(&files.world, &files.scenario, &files.catalogue).unwrap();
    let clients: Vec<_> = PLACES
        .iter()
        .enumerate()
        .map(|(number, [x, y, yaw])| {
            let client = session.connect();
            let init = format!(
                "INIT {{ClassName USARBot.P3AT}} {{Name R{}}} {{Location {x},{y},-0.2}} {{Rotation 0,0,{yaw}}}\r\n",
                number + 1
            );
            session.receive(client, init.as_bytes());
            client
        })
        .collect();
    let mut whim = Noise::new(7, 1);
    let mut settled = None;
    for minute in 0..minutes {
        let mut octets = [0_usize; 8];
        for _ in 0..300 {
            for client in &clients {
                if whim.unit() < 0.1 {
                    let [left, right] = [0; 2].map(|_| whim.symmetric(3.0));
                    let drive = format!("DRIVE {{Left {left:.2}}} {{Right {right:.2}}}\r\n");
                    session.receive(*client, drive.as_bytes());
                }
            }
            session.advance(Span::from_millis(200));
            for (client, sum) in clients.iter().zip(&mut octets) {
                *sum += session.take_output(*client).len();
            }
        }
        let resident = resident();
        println!("minute {}: {octets:?} octets, resident {resident:?}", minute + 1);
        // 300 bursts of 3 kB; who sees nothing at all still has as many numbers to tell.
        assert!(octets.iter().all(|sum| (500_000..2_000_000).contains(sum)), "{octets:?}");
        settled = settled.or(resident);
    }
    if let (Some(settled), Some(now)) = (settled, resident()) {
        assert!(now - settled < 4 << 20, "grew by {} octets", now - settled);
    } else {
        println!("skipped: needs /proc");
    }
}
