//! The classes of the model processes: an actuator, and a filter that moves nothing.

use std::sync::Arc;

use serde_json::json;
use trocar_model::{
    Arg, ClassInfo, Command, CommandKind, Execution, ExecutionLimits, ExecutionModel, Input, Output,
    Overflow, PortType, Ports, Prim, Programs, Provided, Required, Safety, Tag, Type,
};

pub(crate) fn actuator() -> Arc<ClassInfo> {
    class("arm", Safety::Actuator)
}

pub(crate) fn filter() -> Arc<ClassInfo> {
    class("filter", Safety::None)
}

/// A class with a setting, a command, an input, an output and a required interface, all of them optional.
fn class(name: &str, safety: Safety) -> Arc<ClassInfo> {
    let number = || Type::Prim(Prim::F64);
    let value = Arg {
        name: "value".into(),
        doc: "set point".into(),
        ty: number(),
        unit: "mm".into(),
        min: None,
        max: None,
    };
    let write = Command {
        name: "write".into(),
        doc: "moves".into(),
        kind: CommandKind::Write,
        arg: Some(value),
        ret: None,
        ret_unit: String::new(),
        overflow: Overflow::Reject,
    };
    let (arm, robot) = ("arm", "robot");
    let ports = Ports {
        inputs: vec![Input {
            name: "input".into(),
            doc: "a number".into(),
            ty: PortType::Plain(number()),
            tag: Tag::None,
            optional: true,
            fifo: 0,
        }],
        outputs: vec![Output {
            name: "value".into(),
            doc: "a number".into(),
            ty: PortType::Plain(number()),
            tag: Tag::None,
        }],
        required: vec![Required {
            name: robot.into(),
            doc: "whom it moves".into(),
            optional: true,
            functions: vec![],
            handlers: vec![],
        }],
        provided: vec![Provided {
            name: arm.into(),
            doc: "the arm".into(),
            tag: Tag::None,
            commands: vec![write],
            events: vec![],
        }],
        state: None,
    };
    Arc::new(ClassInfo {
        plugin: "toy".into(),
        version: "1.0.0".into(),
        hash: "00".into(),
        name: name.into(),
        doc: "A toy.".into(),
        safety,
        hardware: false,
        safe_from_any_thread: true,
        programs: Programs::None,
        execution: Execution {
            model: Some(ExecutionModel::Periodic),
            period_ns: Some(1_000_000),
            ..Execution::default()
        },
        limits: ExecutionLimits {
            models: ExecutionModel::ALL.to_vec(),
            min_period_ns: Some(100_000),
            max_period_ns: Some(1_000_000_000),
        },
        config_schema: json!({
            "type": "object",
            "properties": { "gain": { "type": "number", "minimum": 0, "default": 1.5, "live": true } },
        }),
        ports,
    })
}
