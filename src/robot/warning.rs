use serde::{Deserialize, Serialize};
use std::fmt;

/// What had to be supposed about a rig because the server did not say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum RigWarning {
    /// The class table does not know the class either.
    UnknownClass {
        /// The class.
        class: String,
    },
    /// GETGEO was not answered.
    NoGeo {
        /// What was asked for.
        what: String,
        /// What is supposed instead.
        supposed: String,
    },
    /// GETCONF was not answered.
    NoConf {
        /// What was asked for.
        what: String,
        /// What is supposed instead.
        supposed: String,
    },
    /// UDK gave distances between wheels in place of the hull.
    WheelsForHull {
        /// Length and width as told, in metres.
        wheels_m: [f64; 2],
        /// Length, width and height supposed, in metres.
        supposed_m: [f64; 3],
    },
    /// An item is mounted on a part that no package explains; it is taken to sit on the body.
    UnknownPart {
        /// The item.
        item: String,
        /// The part.
        part: String,
    },
    /// A link's speed is not known.
    NoLinkSpeed {
        /// The package.
        package: String,
        /// The link, from 1.
        link: u32,
        /// `pan` or `tilt`.
        role: String,
    },
    /// The laser does not tilt: one plane is scanned, no ground is seen.
    Planar,
}

impl fmt::Display for RigWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownClass { class } => {
                write!(f, "class {class} is not in the class table: what is missing is a P2AT's")
            }
            Self::NoGeo { what, supposed } => {
                write!(f, "GETGEO {what} was not answered: supposing {supposed}")
            }
            Self::NoConf { what, supposed } => {
                write!(f, "GETCONF {what} was not answered: supposing {supposed}")
            }
            Self::WheelsForHull { wheels_m: [l, w], supposed_m: [length, width, height] } => {
                write!(
                    f,
                    "GEO gives {l:.2} × {w:.2} m between the wheels, not the hull: supposing \
                 {length:.2} × {width:.2} × {height:.2} m"
                )
            }
            Self::UnknownPart { item, part } => {
                write!(f, "{item} is mounted on {part}, which no package has: supposing the body")
            }
            Self::NoLinkSpeed { package, link, role } => write!(
                f,
                "CONF gives no speed for link {link} ({role}) of {package}: supposing 0.17 rad/s"
            ),
            Self::Planar => write!(f, "the laser does not tilt: 2D mode, drop-offs are not seen"),
        }
    }
}
