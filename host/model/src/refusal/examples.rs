//! What the examples of refusals are about.

use crate::{Arg, ComponentId, MemberId, Name, PortId, Prim, Type, check_range};

/// Names for examples; every literal below keeps to the grammar, which the tests check.
pub(super) fn name(text: &str) -> Name {
    Name::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

pub(super) fn id(text: &str) -> ComponentId {
    ComponentId::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

pub(super) fn port(text: &str) -> PortId {
    PortId::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

pub(super) fn member(text: &str) -> MemberId {
    MemberId::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

pub(super) fn texts(list: &[&str]) -> Vec<String> {
    list.iter().map(|&s| s.to_owned()).collect()
}

pub(super) fn robot() -> ComponentId {
    id("host/robot")
}

pub(super) fn client() -> PortId {
    port("host/bscan/robot")
}

pub(super) fn server() -> PortId {
    port("host/robot/arm")
}

pub(super) fn input() -> PortId {
    port("host/log/force")
}

pub(super) fn output() -> PortId {
    port("host/sensor/force")
}

pub(super) fn call() -> MemberId {
    member("host/robot/arm/servo_jp")
}

/// The sentence on an argument that its command does not take.
pub(super) fn beyond_its_limits() -> String {
    let arg = Arg {
        name: "value".into(),
        doc: "set point".into(),
        ty: Type::Prim(Prim::I32),
        unit: "mm".into(),
        min: Some(0.0),
        max: Some(100.0),
    };
    check_range(&arg, &300.into()).err().unwrap_or_default()
}
