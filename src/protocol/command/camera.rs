//! `CAMERA`: the 2.x predecessor of MISPKG and SET Camera.

use super::Order;
use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `CAMERA {Rotation r,p,y} {Order i} {Zoom f}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraCommand {
    /// roll, pitch, yaw in radians.
    pub rotation: Option<[f64; 3]>,
    /// What the angles are.
    pub order: Option<Order>,
    /// Field of view.
    pub zoom: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl CameraCommand {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            rotation: fields.engine_vector("Rotation"),
            order: Order::read(fields),
            zoom: fields.engine_number("Zoom"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        if let Some(rotation) = &self.rotation {
            w.shortest_list("Rotation", rotation);
        }
        w.optional_integer("Order", self.order.map(Order::code));
        if let Some(zoom) = self.zoom {
            w.shortest("Zoom", zoom);
        }
        w.extra(&self.extra);
    }
}
