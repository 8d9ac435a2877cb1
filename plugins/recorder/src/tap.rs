//! Samples of a component's taps: its events or its commands, all in one stream, each as a topic of its own.
//!
//! Invariant: the tap's own description says what a member's bytes mean; a sample that is cut or of an
//! unknown member is told as lost, never as something else.

use std::collections::BTreeMap;

use trocar_sdk::AnyType;
use trocar_sdk::serde_json::{Value as Json, json};

use crate::block::Kind;
use crate::orders::Channel;
use crate::seen::Seen;
use crate::typed::{self, Typed};
use crate::way::Way;

/// Places of the parts of a sample, and its possible members.
pub(crate) struct Tap {
    which: usize,
    outcome: Option<usize>,
    len: usize,
    whole: usize,
    bytes: usize,
    room: usize,
    /// By their numbers.
    members: BTreeMap<u32, Member>,
    outcomes: BTreeMap<i64, String>,
}

struct Member {
    typed: Typed,
    size: usize,
    channel: u32,
}

fn text<'a>(value: &'a Json, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_default()
}

fn find<'a>(types: &'a Json, name: &str) -> Option<&'a Json> {
    types.as_array()?.iter().find(|ty| ty["name"] == name)
}

/// Names and numbers of an enum that a field refers to.
fn values(types: &Json, field: &Json) -> Vec<(String, i64)> {
    let of = find(types, text(&field["type"], "ref")).map(|ty| &ty["values"]);
    let all = of.and_then(Json::as_array).into_iter().flatten();
    all.filter_map(|v| Some((text(v, "name").to_owned(), v["value"].as_i64()?))).collect()
}

impl Tap {
    /// Returns none if the description is none of a tap. `name` is that of the tap,
    /// `/process/component/tap_events`: its members are topics below it, where no other output's can be, for
    /// the name is reserved.
    pub(crate) fn of(description: &str, name: &str, add: &mut dyn FnMut(Channel) -> u32) -> Option<Tap> {
        let json: Json = trocar_sdk::serde_json::from_str(description).ok()?;
        let types = &json["types"];
        let called = text(&json["plain"], "ref");
        // A host puts what tells two of them apart behind the name.
        let commands = called.starts_with("TapCommands");
        if !commands && !called.starts_with("TapEvents") {
            return None;
        }
        let fields = find(types, called)?["fields"].as_array()?;
        let field = |name: &str| fields.iter().find(|f| f["name"] == name);
        let at = |name: &str| field(name)?["at"].as_u64().and_then(|n| usize::try_from(n).ok());
        let room = field("bytes")?["type"]["n"].as_u64().and_then(|n| usize::try_from(n).ok())?;
        let mut members = BTreeMap::new();
        for (member, number) in values(types, field("which")?) {
            let Ok(number) = u32::try_from(number) else { continue };
            let payload = field(&member).filter(|f| f["type"]["n"] == 0).map(|f| {
                let unit = text(f, "unit").to_owned();
                (json!({ "plain": f["type"]["array"], "types": types }).to_string(), unit)
            });
            let ty = payload.as_ref().and_then(|(text, _)| AnyType::of_port(text).ok());
            let said = payload.as_ref().map_or("", |(text, _)| text.as_str());
            let typed =
                Typed::of_member(ty.as_ref(), typed::hash(&format!("[{said:?},{member:?}]")), commands);
            let mut metadata = BTreeMap::from([(
                "trocar.member".to_owned(),
                if commands { "command" } else { "event" }.to_owned(),
            )]);
            if let Some((text, unit)) = &payload {
                metadata.insert("trocar.type".to_owned(), text.clone());
                if !unit.is_empty() {
                    metadata.insert("unit:value".to_owned(), unit.clone());
                }
            }
            for (path, unit) in &typed.units {
                metadata.insert(format!("unit:{path}"), unit.clone());
            }
            let channel = add(Channel {
                topic: format!("{name}/{member}"),
                schema: typed.name.clone(),
                schema_encoding: "protobuf",
                schema_data: typed.descriptors.clone(),
                encoding: "protobuf",
                metadata,
            });
            members.insert(number, Member { typed, size: ty.map_or(0, |ty| ty.size()), channel });
        }
        let outcomes = field("outcome").map(|f| values(types, f)).unwrap_or_default();
        Some(Tap {
            which: at("which")?,
            outcome: if commands { Some(at("outcome")?) } else { None },
            len: at("len")?,
            whole: at("whole")?,
            bytes: at("bytes")?,
            room,
            members,
            outcomes: outcomes.into_iter().map(|(name, number)| (number, name)).collect(),
        })
    }

    /// Writes a sample to its member's topic; returns the number of bytes, none if its member is unknown.
    pub(crate) fn write(
        &self,
        seen: &Seen<'_>,
        (now_ns, stamp_ns): (u64, u64),
        way: &mut Way,
    ) -> Option<usize> {
        let word = |at: usize| {
            let bytes = seen.value.get(at..at + 4)?;
            bytes.first_chunk::<4>().map(|b| u32::from_le_bytes(*b))
        };
        let (which, len, whole) = (word(self.which)?, word(self.len)?, word(self.whole)?);
        let member = self.members.get(&which)?;
        let room = seen.value.get(self.bytes..self.bytes + self.room).unwrap_or_default();
        let payload = room.get(..len as usize)?;
        if whole > len || payload.len() < member.size {
            return None;
        }
        let outcome = self.outcome.and_then(word).map(u32::cast_signed);
        let head = (member.channel, seen.seq, now_ns, stamp_ns);
        Some(way.block().push(head, Kind::Ready, |to| {
            member.typed.encode(payload, 0, to);
            if let Some(number) = outcome {
                let word = self.outcomes.get(&i64::from(number)).map_or("", String::as_str);
                Typed::outcome(word, to);
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use prost_reflect::{DescriptorPool, DynamicMessage, Value};

    use super::*;
    use crate::orders::Order;
    use crate::way::way;

    const COMMANDS: &str = r#"{"plain": {"ref": "TapCommands"}, "types": [
        {"name": "Which", "enum": "u32", "values": [{"name": "arm/move", "value": 4}, {"name": "arm/hold", "value": 5}]},
        {"name": "Outcome", "enum": "i32", "values": [{"name": "EXECUTED", "value": 0}, {"name": "FAILED", "value": -3}]},
        {"name": "TapCommands", "size": 32, "fields": [
          {"name": "which", "at": 0, "type": {"ref": "Which"}}, {"name": "outcome", "at": 4, "type": {"ref": "Outcome"}},
          {"name": "len", "at": 8, "type": "u32"}, {"name": "whole", "at": 12, "type": "u32"},
          {"name": "bytes", "at": 16, "type": {"array": "u8", "n": 16}},
          {"name": "arm/move", "at": 32, "unit": "m", "type": {"array": "f64", "n": 0}}]}]}"#;

    fn sample(which: u32, outcome: i32, len: u32, whole: u32, bytes: &[u8]) -> Vec<u8> {
        let mut value: Vec<u8> =
            [which, outcome.cast_unsigned(), len, whole].iter().flat_map(|n| n.to_le_bytes()).collect();
        value.extend_from_slice(bytes);
        value.resize(32, 0);
        value
    }

    #[test]
    fn each_command_is_a_topic_with_its_argument_and_how_it_ended() {
        let mut channels = Vec::new();
        let mut add = |channel| {
            channels.push(channel);
            channels.len() as u32 - 1
        };
        let tap = Tap::of(COMMANDS, "/host/robot/tap_commands", &mut add).expect("a tap");
        let topics: Vec<&str> = channels.iter().map(|c| c.topic.as_str()).collect();
        assert_eq!(topics, ["/host/robot/tap_commands/arm/move", "/host/robot/tap_commands/arm/hold"]);
        let (mut way, received, _) = way(1 << 20);
        let mut take = |value: &[u8]| tap.write(&Seen::plain(value, 1, 1), (1, 1), &mut way).is_some();
        assert!(take(&sample(4, -3, 8, 8, &2.5f64.to_le_bytes())));
        assert!(take(&sample(5, 0, 0, 0, &[])));
        for (wrong, value) in [
            ("unknown", sample(9, 0, 0, 0, &[])),
            ("cut", sample(4, 0, 8, 9, &[0; 8])),
            ("too long", sample(4, 0, 17, 17, &[])),
            ("too short", sample(4, 0, 4, 4, &[])),
            ("no sample", vec![4; 3]),
        ] {
            assert!(!take(&value), "{wrong}");
        }
        way.send();
        let Ok(Order::Block(block)) = received.try_recv() else { panic!("a block") };
        let read: Vec<DynamicMessage> = block
            .messages()
            .map(|(head, [bytes, _])| {
                let channel = &channels[head.channel as usize];
                let pool = DescriptorPool::decode(channel.schema_data.as_slice()).expect("descriptors");
                let message = pool.get_message_by_name(&channel.schema).expect("its own name");
                DynamicMessage::decode(message, bytes).expect("a message")
            })
            .collect();
        let got = |n: usize, name: &str| read[n].get_field_by_name(name).expect(name).into_owned();
        assert_eq!(
            (got(0, "value"), got(0, "trocar_outcome")),
            (Value::F64(2.5), Value::String("FAILED".into()))
        );
        assert_eq!(got(1, "trocar_outcome"), Value::String("EXECUTED".into()));
        assert_eq!(channels[0].metadata.get("unit:value").map(String::as_str), Some("m"));
    }

    #[test]
    fn another_payload_is_no_tap() {
        let scalar = COMMANDS.replace("TapCommands", "Other");
        assert!(Tap::of(&scalar, "/a/b/c", &mut |_| 0).is_none());
        assert!(Tap::of("nonsense", "/a/b/c", &mut |_| 0).is_none());
    }
}
