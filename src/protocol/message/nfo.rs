//! `NFO`: the greeting, start poses and path nodes.

use crate::protocol::encode::{LineWriter, joined};
use crate::protocol::fields::Fields;
use crate::protocol::problem::{Problem, ProblemKind};
use crate::protocol::{Dialect, NamedPose, Segment, WirePose, number, text};
use serde::{Deserialize, Serialize};

/// One `NFO` line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Nfo {
    /// The first line of a connection; the same in both dialects.
    Greeting(Greeting),
    /// The reply to `GETSTARTPOSES`.
    StartPoses(Vec<NamedPose>),
    /// The reply to `GETPATHNODES` (UDK).
    PathNodes(Vec<NamedPose>),
    /// The reply to `GETCLOSESTPATHNODE` (UDK).
    ClosestNode {
        /// The node's name.
        name: String,
        /// Metres, wire frame.
        location: [f64; 3],
    },
}

/// `NFO {Gametype g} {Level map} {TimeLimit n}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Greeting {
    /// `BotDeathMatch` in both dialects.
    pub gametype: String,
    /// The map, such as `DM-Factory_250`.
    pub level: String,
    /// Minutes; 0 is none.
    pub time_limit: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Nfo {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        for (key, make) in [
            ("StartPoses", Self::StartPoses as fn(_) -> _),
            ("PathNodes", Self::PathNodes as fn(_) -> _),
        ] {
            if fields.has(key) {
                let count = fields.integer(key);
                let count = fields.require(key, count)?;
                return read_poses(fields, key, count).map(make);
            }
        }
        if fields.has("Pathnode") {
            let name = fields.text("Pathnode").unwrap_or_default();
            let location = fields.vector("Location");
            return Ok(Self::ClosestNode { name, location: fields.require("Location", location)? });
        }
        let gametype = fields.text("Gametype");
        Ok(Self::Greeting(Greeting {
            gametype: fields.require("Gametype", gametype)?,
            level: fields.text("Level").unwrap_or_default(),
            time_limit: fields.integer("TimeLimit"),
            extra: fields.rest(),
        }))
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        match self {
            Self::Greeting(greeting) => {
                w.text("Gametype", &greeting.gametype).text("Level", &greeting.level);
                w.optional_integer("TimeLimit", greeting.time_limit).extra(&greeting.extra);
            }
            Self::StartPoses(poses) => write_poses(w, "StartPoses", poses, dialect),
            Self::PathNodes(poses) => write_poses(w, "PathNodes", poses, dialect),
            Self::ClosestNode { name, location } => {
                w.text("Pathnode", name).list("Location", location, 4);
            }
        }
    }
}

/// Reads the keyless list `name x,y,z r,p,y name …`, or one `{Name n Location … Orientation …}` a
/// pose as older clients document it.
fn read_poses(fields: &mut Fields<'_>, key: &str, count: i64) -> Result<Vec<NamedPose>, Problem> {
    let mut poses = Vec::new();
    let groups = fields.groups("Name");
    if groups.is_empty() {
        for field in fields.take_all() {
            read_triples(field.body, &mut poses)
                .map_err(|kind| Problem::new(kind, 0, field.body))?;
        }
    } else {
        poses = fields.read_groups(groups, |group| {
            let name = group.name();
            let pose = group.pose();
            Ok(NamedPose { name, pose: group.require("Location", pose)? })
        });
    }
    if usize::try_from(count) != Ok(poses.len()) {
        let expected = usize::try_from(count).unwrap_or(0);
        let kind = ProblemKind::WrongCount { key: key.to_owned(), found: poses.len(), expected };
        fields.problems.push(Problem::new(kind, 0, &[]));
    }
    Ok(poses)
}

fn read_triples(list: &[u8], poses: &mut Vec<NamedPose>) -> Result<(), ProblemKind> {
    let bad = || ProblemKind::NotANumber("StartPoses".to_owned());
    let words: Vec<_> = text::words(list).collect();
    let mut at = 0;
    while at < words.len() {
        // A marker's name may hold blanks: it goes on until a word that is a vector.
        let is_vector = |word: &&&[u8]| number::array::<3>(word).is_ok();
        let name_length = words[at..].iter().take_while(|word| !is_vector(word)).count();
        let [location, orientation] = [0, 1].map(|offset| words.get(at + name_length + offset));
        let vector =
            |word: Option<&&[u8]>| number::array::<3>(word.ok_or_else(bad)?).map_err(|_| bad());
        poses.push(NamedPose {
            name: text::from_wire(&words[at..at + name_length].join(&b' ')),
            pose: WirePose { location: vector(location)?, orientation: vector(orientation)? },
        });
        at += name_length + 2;
    }
    Ok(())
}

/// UT2004 prints two decimals, UDK four; with no pose there is no second segment.
fn write_poses(w: &mut LineWriter, key: &str, poses: &[NamedPose], dialect: Dialect) {
    let decimals = match dialect {
        Dialect::Ut2004 => 2,
        Dialect::Udk => 4,
    };
    w.integer(key, poses.len() as i64);
    if poses.is_empty() {
        return;
    }
    let list: Vec<_> = poses
        .iter()
        .map(|NamedPose { name, pose }| {
            let location = joined(&pose.location, decimals);
            format!("{name} {location} {}", joined(&pose.orientation, decimals))
        })
        .collect();
    w.bare(&list.join(" "));
}
