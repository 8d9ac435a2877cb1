//! The common part of all ports: the kind of data they carry, the way they are tied to a slot, and the checks
//! of their types when a plugin is built.
//!
//! Invariant: a port is described by the same type that its methods read from or write to the slot.

use crate::lease::Tie;
use trocar_plugin_api::desc::{PortType, Prim, TypeDesc, TypeKind};

/// Type that a port carries, before field settings are added.
pub enum PortKind {
    Plain(&'static TypeDesc),
    Frame { header: &'static TypeDesc, format: &'static str },
    Any,
}

/// A port that is tied to a slot of the host.
///
/// # Safety
/// `KIND` describes what the port reads from or writes to the slot.
pub unsafe trait Flow {
    type Slot;
    const KIND: PortKind;
    /// # Safety
    /// `slot` is valid while the lease of `tie` is held, and carries what `KIND` says.
    unsafe fn attach(&mut self, slot: *const Self::Slot, tie: &Tie);
}

/// The manifest's port type of a field; the field's own `format` wins over the header's.
pub const fn port_type<P: Flow>(format: &'static str, max_bytes: usize) -> PortType {
    let plain = !matches!(P::KIND, PortKind::Frame { .. });
    assert!(
        !plain || (format.is_empty() && max_bytes == 0),
        "format and max_bytes are settings of a port of frames"
    );
    match P::KIND {
        PortKind::Plain(ty) => PortType::Plain(ty),
        PortKind::Frame { header, format: own } => {
            PortType::Frame { header, format: if format.is_empty() { own } else { format }, max_bytes }
        }
        PortKind::Any => PortType::Any,
    }
}

/// The payload of an input or output; none of an untyped one.
pub const fn payload_of(port: PortType) -> Option<&'static TypeDesc> {
    match port {
        PortType::Plain(ty) | PortType::Frame { header: ty, .. } => Some(ty),
        PortType::Any => None,
    }
}

/// Fails the build where payloads without coordinates have a coordinate frame.
pub const fn frame_fits(payloads: &[Option<&'static TypeDesc>]) {
    let mut i = 0;
    while i < payloads.len() {
        if let Some(ty) = payloads[i]
            && ty.takes_frame()
        {
            return;
        }
        i += 1;
    }
    panic!(
        "nothing here can be in a coordinate frame: use a payload with coordinates (arrays of f64 or f32 in a struct, such as the \
         position of a Pose). Its fields must not name a frame already"
    );
}

/// Fails the build where an argument without numbers has limits: they would be shown and never hold.
pub const fn limits_fit(ty: &TypeDesc) {
    assert!(
        ty.has_numbers(),
        "min and max are limits of numbers, and this argument has none (a Flag, a Stamp, a Text and named values are no \
         numbers): remove min and max, or take a number"
    );
}

/// Fails the build where an argument without numbers and without a time has a unit.
pub const fn unit_fits(ty: &TypeDesc) {
    let time = matches!(ty.kind, TypeKind::Prim(Prim::Stamp));
    assert!(
        time || ty.has_numbers(),
        "a unit is one of numbers, and this argument has none (a Flag, a Text and named values are no numbers): remove \
         the unit, or take a number"
    );
}
