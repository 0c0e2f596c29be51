//! `MISPKG`: the links of a mission package (UT2004; UDK accepts it for actuators).

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::{Dialect, Segment};
use serde::{Deserialize, Serialize};

/// What the value of a joint command is (protocol document 4.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// 0: absolute angle in radians, metres on a slider.
    #[default]
    Angle,
    /// 1: speed in rad/s or m/s.
    Velocity,
    /// 2: torque.
    Torque,
    /// 3: brake.
    Brake,
    /// 10: angle relative to the present one.
    RelAngle,
    /// 11: speed relative to the present one.
    RelVelocity,
    /// 12: torque relative to the present one.
    RelTorque,
    /// Any other code.
    Other(i64),
}

impl Order {
    /// The order with this code.
    pub fn from_code(code: i64) -> Self {
        match code {
            0 => Self::Angle,
            1 => Self::Velocity,
            2 => Self::Torque,
            3 => Self::Brake,
            10 => Self::RelAngle,
            11 => Self::RelVelocity,
            12 => Self::RelTorque,
            code => Self::Other(code),
        }
    }

    /// The number on the wire.
    pub fn code(self) -> i64 {
        match self {
            Self::Angle => 0,
            Self::Velocity => 1,
            Self::Torque => 2,
            Self::Brake => 3,
            Self::RelAngle => 10,
            Self::RelVelocity => 11,
            Self::RelTorque => 12,
            Self::Other(code) => code,
        }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Option<Self> {
        fields.engine_integer("Order").map(Self::from_code)
    }
}

/// `MISPKG {Name n} {Link 1} {Value v} [{Order o}] {Link 2} …`, or the 2.x form
/// `MISPKG {Name n} {Rotation r,p,y} {Order o}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MisPkg {
    /// The package.
    pub name: String,
    /// What its links shall do.
    pub form: MisPkgForm,
    /// Arms: 0 or 1.
    pub gripper: Option<i64>,
    /// Arms: a stored sequence.
    pub sequence: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// The two forms of a package command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum MisPkgForm {
    /// Links one by one.
    Links(Vec<MisPkgLink>),
    /// 2.x: 0, pan right +, tilt up +, in radians.
    Rotation {
        /// roll, pan, tilt as they stand on the wire.
        rotation: [f64; 3],
        /// What the angles are.
        order: Option<Order>,
    },
}

impl Default for MisPkgForm {
    fn default() -> Self {
        Self::Links(Vec::new())
    }
}

/// One link of a package command.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MisPkgLink {
    /// From 1.
    pub link: i64,
    /// Radians, rad/s or torque, by the order.
    pub value: f64,
    /// Absolute angle if absent.
    pub order: Option<Order>,
}

impl MisPkg {
    /// Links (from 1) to absolute angles in radians.
    pub fn angles(name: &str, links: impl IntoIterator<Item = (i64, f64)>) -> Self {
        let link = |(link, value)| MisPkgLink { link, value, order: None };
        let form = MisPkgForm::Links(links.into_iter().map(link).collect());
        Self { name: name.to_owned(), form, ..Self::default() }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let name = fields.name();
        let gripper = fields.engine_integer("Gripper");
        let sequence = fields.engine_integer("Seq").or_else(|| fields.engine_integer("Sequence"));
        let form = match fields.engine_vector("Rotation") {
            Some(rotation) => MisPkgForm::Rotation { rotation, order: Order::read(fields) },
            None => {
                let groups = fields.groups("Link");
                MisPkgForm::Links(fields.read_groups(groups, |group| {
                    Ok(MisPkgLink {
                        link: group.engine_integer("Link").unwrap_or(0),
                        value: group.engine_number("Value").unwrap_or(0.0),
                        order: Order::read(group),
                    })
                }))
            }
        };
        Self { name, form, gripper, sequence, extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        w.text("Name", &self.name);
        match &self.form {
            MisPkgForm::Links(links) => {
                for MisPkgLink { link, value, order } in links {
                    w.integer("Link", *link).shortest("Value", *value);
                    // UDK takes a link only as the triple Link, Value, Order.
                    let needed = (dialect == Dialect::Udk).then_some(Order::Angle);
                    w.optional_integer("Order", order.or(needed).map(Order::code));
                }
            }
            MisPkgForm::Rotation { rotation, order } => {
                w.shortest_list("Rotation", rotation);
                w.optional_integer("Order", order.map(Order::code));
            }
        }
        w.optional_integer("Gripper", self.gripper).optional_integer("Seq", self.sequence);
        w.extra(&self.extra);
    }
}
