//! Coordinate frames that a manifest gives to a whole port: given to the fields that hold its coordinates.
//!
//! Invariant: a frame is never ignored. Where nothing could be in it, or the payload names all frames itself,
//! the class is refused.

use trocar_model::{PortType, Type};

/// Returns the type that flows through an input or output.
pub(super) fn port(ty: PortType, frame: &str) -> Result<PortType, String> {
    Ok(match ty {
        PortType::Plain(ty) => PortType::Plain(value(ty, frame)?),
        PortType::Frame { header, format, max_bytes } => {
            PortType::Frame { header: value(header, frame)?, format, max_bytes }
        }
        PortType::Any if frame.is_empty() => PortType::Any,
        PortType::Any => return Err(nothing("what has no type of its own", frame)),
    })
}

pub(super) fn value(ty: Type, frame: &str) -> Result<Type, String> {
    if frame.is_empty() {
        return Ok(ty);
    }
    ty.in_frame(frame).ok_or_else(|| nothing(&ty.title(), frame))
}

/// A result or an event's payload.
pub(super) fn optional(ty: Option<Type>, frame: &str) -> Result<Option<Type>, String> {
    match ty {
        Some(ty) => value(ty, frame).map(Some),
        None if frame.is_empty() => Ok(None),
        None => Err(nothing("what carries nothing", frame)),
    }
}

/// Argument and result of a function: whichever has coordinates.
pub(super) fn either(
    arg: Option<Type>,
    ret: Option<Type>,
    frame: &str,
) -> Result<(Option<Type>, Option<Type>), String> {
    if frame.is_empty() {
        return Ok((arg, ret));
    }
    let framed = |ty: &Option<Type>| ty.as_ref().and_then(|ty| ty.in_frame(frame));
    match (framed(&arg), framed(&ret)) {
        (None, None) => Err(nothing("what it passes", frame)),
        (a, r) => Ok((a.or(arg), r.or(ret))),
    }
}

fn nothing(what: &str, frame: &str) -> String {
    format!(
        "{what} has no coordinates that could be in frame \"{frame}\", or its fields say already in which they are"
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use serde_json::{Value, json};

    use super::super::{back, classes};

    /// A class with one port of each kind; `change` is applied to it.
    fn class(change: impl FnOnce(&mut Value)) -> Result<std::sync::Arc<trocar_model::ClassInfo>, String> {
        let pose = json!({ "ref": "Pose" });
        let mut class = json!({
            "name": "tool", "execution": { "model": "on_signal" }, "config": {},
            "inputs": [{ "name": "goal", "type": { "plain": pose }, "frame": "retina" }],
            "outputs": [{ "name": "count", "type": { "plain": "u64" } }],
            "required": [{ "name": "robot", "functions": [{ "name": "move", "arg": pose, "frame": "robot" }],
                "handlers": [{ "name": "moved", "payload": pose, "frame": "robot" }] }],
            "provided": [{ "name": "ctl", "events": [{ "name": "done" }], "commands": [
                { "name": "turn", "kind": "write_return", "arg": { "type": pose, "frame": "retina" },
                  "ret": pose, "ret_frame": "robot" }] }]
        });
        change(&mut class);
        let manifest = json!({
            "trocar": 1, "abi": [1, 2], "name": "toy", "version": "1.0.0",
            "types": [{ "name": "Pose", "size": 32, "align": 8, "fields": [
                { "name": "stamp", "at": 0, "type": "stamp" },
                { "name": "p", "at": 8, "type": { "array": "f64", "n": 3 }, "unit": "m" }
            ]}],
            "classes": [class]
        });
        Ok(classes(&serde_json::from_value(manifest).unwrap(), "")?.remove(0))
    }

    #[test]
    fn a_frame_said_of_what_has_no_coordinates_refuses_the_class_and_names_the_place() {
        class(|_| {}).unwrap();
        for (place, key, what) in [
            ("/outputs/0", "frame", "output count: u64 has no coordinates that could be in frame \"base\""),
            (
                "/inputs/0/type",
                "plain",
                "input goal: f64 has no coordinates that could be in frame \"retina\"",
            ),
            ("/provided/0/events/0", "frame", "event ctl/done: what carries nothing has no coordinates"),
            ("/required/0/functions/0", "arg", "function robot/move: what it passes has no coordinates"),
            ("/required/0/handlers/0", "payload", "handler robot/moved: u64 has no coordinates"),
            ("/provided/0/commands/0", "ret", "command ctl/turn: f64 has no coordinates"),
        ] {
            let why = class(|class| {
                let value = match key {
                    "frame" => "base",
                    "payload" => "u64",
                    _ => "f64",
                };
                class.pointer_mut(place).unwrap()[key] = value.into();
            });
            let why = why.unwrap_err();
            assert!(why.contains(what), "{what:?} is not in: {why}");
        }
    }

    #[test]
    fn limits_of_an_argument_without_numbers_are_refused() {
        let with = |ty: Value| {
            class(|class| {
                let arg = class.pointer_mut("/provided/0/commands/0/arg").unwrap();
                (arg["type"], arg["max"]) = (ty, 1.into());
                arg.as_object_mut().unwrap().remove("frame");
            })
        };
        assert!(with("f64".into()).is_ok() && with(serde_json::json!({ "list": "u8", "n": 3 })).is_ok());
        for ty in ["bool", "stamp"] {
            let why = with(ty.into()).unwrap_err();
            assert!(why.contains("command turn: min and max of its argument are limits of numbers"), "{why}");
        }
        let with_unit = |ty: &str| {
            class(|class| {
                let arg = class.pointer_mut("/provided/0/commands/0/arg").unwrap();
                (arg["type"], arg["unit"]) = (ty.into(), "ns".into());
                arg.as_object_mut().unwrap().remove("frame");
            })
        };
        assert!(with_unit("u64").is_ok() && with_unit("stamp").is_ok());
        let why = with_unit("bool").unwrap_err();
        assert!(why.contains("command turn: the unit \"ns\" of its argument is one of numbers"), "{why}");
    }

    #[test]
    fn an_argument_and_a_result_in_two_frames_are_told_to_an_untyped_function_as_two_types() {
        let info = class(|_| {}).unwrap();
        let told: Value = serde_json::from_str(&back::command(&info.ports.provided[0].commands[0])).unwrap();
        let frame = |of: &Value| {
            let types = told["types"].as_array().unwrap();
            types.iter().find(|t| t["name"] == *of).unwrap()["fields"][1]["frame"].clone()
        };
        assert_eq!(frame(&told["arg"]["type"]["ref"]), "retina");
        assert_eq!(frame(&told["ret"]["ref"]), "robot");
    }
}
