use crate::driver::host::Host;
use crate::driver::lockstep::Lockstep;
use crate::files::scenario;
use crate::mission::{Agent, Placement};
use crate::record::{Header, Writer};
use crate::sim::Session;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `usar mission`.
#[derive(Debug, Args)]
pub struct MissionArguments {
    /// Scenario file, or the name of one that comes with the program.
    scenario: PathBuf,
    /// Seed of the simulator's noise, instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// Length of the mission in seconds, instead of the scenario's.
    #[arg(long)]
    time_limit: Option<f64>,
}

/// Runs one mission in lockstep.
pub fn run(arguments: &MissionArguments) -> Result<ExitCode> {
    let mut loaded = scenario::load(&arguments.scenario, &[])?;
    if let Some(seed) = arguments.seed {
        loaded.scenario.seed = seed;
    }
    if let Some(limit) = arguments.time_limit {
        loaded.agent.mission.time_limit_s = limit;
    }
    let session = Session::new(&loaded.world, &loaded.scenario, &loaded.catalogue)?;
    let placement =
        loaded.scenario.robots[0].start.clone().map_or(Placement::FirstStart, Placement::Start);
    let agent = Agent::new(loaded.agent.clone(), placement);
    let header = Header {
        seed: loaded.scenario.seed,
        scenario: loaded.name.clone(),
        config: toml::to_string(&loaded.agent)?,
    };
    let host = Host::new(agent, Some(Writer::new(Vec::new(), &header)?));
    let mut lockstep = Lockstep::new(session, vec![host])?;
    let mut seen = 0;
    let mut last = 0.0;
    while lockstep.step()? {
        let agent = lockstep.agents().next().expect("one agent");
        for note in agent.journal().since(seen) {
            println!("{:8.2} {:?} {}", note.arrival.seconds(), note.level, note.text);
        }
        seen = agent.journal().len();
        if lockstep.now().seconds() - last > 20.0 {
            last = lockstep.now().seconds();
            if let (Some(running), Some(truth)) = (agent.running(), lockstep.truth(0)) {
                let p = running.belief().world_from_robot().translation.vector;
                let t = truth.world_from_robot.translation.vector;
                println!(
                    "{last:8.2} pose {:.3} {:.3} {:.3} truth {:.3} {:.3} {:.3} falls {} coll {} {:.2}",
                    p.x,
                    p.y,
                    p.z,
                    t.x,
                    t.y,
                    t.z,
                    truth.falls,
                    truth.collisions,
                    truth.worst_collision_mps
                );
            }
        }
    }
    let agent = lockstep.agents().next().expect("one agent");
    for note in agent.journal().since(seen) {
        println!("{:8.2} {:?} {}", note.arrival.seconds(), note.level, note.text);
    }
    if let Some(running) = agent.running() {
        let grid = running.belief().grid();
        let overlay = crate::export::map_picture::Overlay {
            title: loaded.name.clone(),
            trajectory: running.belief().trajectory().iter().map(|(_, p)| *p).collect(),
            ..Default::default()
        };
        std::fs::write("/tmp/map.png", crate::export::map_picture::draw(&grid, &overlay).to_png())?;
    }
    println!("{:?}", agent.tally());
    Ok(ExitCode::SUCCESS)
}
