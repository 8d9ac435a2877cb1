//! The system interface every component has without any code: its types, and the answers to its reads.
//!
//! Invariant: it is the last provided interface of every class, so ids of the class's own commands and events
//! stay what the plugin's manifest says.

use std::sync::Arc;

use trocar_model::{Command, CommandKind, Event, Field, Overflow, Prim, Provided, StructType, Tag, Type};

/// Its name; no class may use it for a port of its own.
pub const INTERFACE: &str = "system";

/// Positions of its commands, counted from its first.
pub const GET_STATE: usize = 0;
pub const PERIOD_STATISTICS: usize = 1;

/// Positions of its events, counted from its first.
pub const STATUS: usize = 0;
pub const WARNING: usize = 1;
pub const ERROR: usize = 2;
pub const STATE_CHANGED: usize = 3;

/// Room for the sentence of a message event, bytes.
const TEXT: usize = 248;

/// The interface as it is appended to each class.
pub fn interface() -> Provided {
    let read = |name: &str, doc: &str, ret: Type| Command {
        name: name.into(),
        doc: doc.into(),
        kind: CommandKind::Read,
        arg: None,
        ret: Some(ret),
        ret_unit: String::new(),
        overflow: Overflow::Reject,
    };
    let event = |name: &str, doc: &str, payload: Type| Event {
        name: name.into(),
        doc: doc.into(),
        payload: Some(payload),
        unit: String::new(),
    };
    Provided {
        name: INTERFACE.into(),
        doc: "What every component offers: its state, its timing, its messages.".into(),
        tag: Tag::None,
        commands: vec![
            read("GetState", "State and health of the component.", status_type()),
            read(
                "period_statistics",
                "Period, compute time, lateness and overruns since Start.",
                statistics_type(),
            ),
        ],
        events: vec![
            event("status", "Something worth knowing.", message_type()),
            event("warning", "Something that should be looked at.", message_type()),
            event("error", "Something that went wrong; the component may be in FAULT.", message_type()),
            event("state_changed", "The component's state or health changed.", status_type()),
        ],
    }
}

fn structure(name: &str, fields: Vec<(&str, Type, &str, &str)>) -> Type {
    let mut at = 0;
    let mut align = 1;
    let fields = fields
        .into_iter()
        .map(|(name, ty, unit, doc)| {
            let field =
                Field { name: name.into(), at, unit: unit.into(), doc: doc.into(), frame: String::new(), ty };
            at += field.ty.size();
            align = align.max(field.ty.align());
            field
        })
        .collect();
    Type::Struct(Arc::new(StructType { name: name.into(), doc: String::new(), size: at, align, fields }))
}

fn status_type() -> Type {
    structure(
        "ComponentStatus",
        vec![
            ("stamp", Type::Prim(Prim::Stamp), "", "when it was so"),
            ("state", Type::Text { n: 24 }, "", "CREATED, READY, ACTIVE, STOPPED{reason}, FAULT"),
            ("health", Type::Text { n: 24 }, "", "OK, OVERRUN, STALE_INPUT, UNRESPONSIVE, LOST"),
            ("fault", Type::Text { n: TEXT }, "", "why it is in FAULT"),
        ],
    )
}

fn message_type() -> Type {
    structure(
        "SystemMessage",
        vec![
            ("stamp", Type::Prim(Prim::Stamp), "", "when"),
            ("text", Type::Text { n: TEXT }, "", "one sentence"),
        ],
    )
}

/// Figures of `period_statistics`, in the order of its fields.
pub struct Statistics {
    pub stamp_ns: u64,
    /// avg, std, min, max; s.
    pub period: [f64; 4],
    pub compute: [f64; 4],
    /// p50, p99, max; s.
    pub lateness: [f64; 3],
    pub load: f64,
    pub executed: u64,
    pub skipped: u64,
    pub overruns: u64,
}

fn statistics_type() -> Type {
    let f = || Type::Prim(Prim::F64);
    let u = || Type::Prim(Prim::U64);
    structure(
        "PeriodStatistics",
        vec![
            ("stamp", Type::Prim(Prim::Stamp), "", "when"),
            ("period_avg", f(), "s", "from one begin to the next"),
            ("period_std", f(), "s", "its standard deviation"),
            ("period_min", f(), "s", "shortest"),
            ("period_max", f(), "s", "longest"),
            ("compute_avg", f(), "s", "time inside a cycle"),
            ("compute_std", f(), "s", "its standard deviation"),
            ("compute_min", f(), "s", "shortest"),
            ("compute_max", f(), "s", "longest"),
            ("lateness_p50", f(), "s", "how late cycles began: half of them less than this"),
            ("lateness_p99", f(), "s", "99 of 100 less than this"),
            ("lateness_max", f(), "s", "latest"),
            ("load", f(), "", "compute time over period"),
            ("executed", u(), "", "cycles that ran"),
            ("skipped", u(), "", "cycles of the grid that were left out"),
            ("overruns", u(), "", "cycles that took longer than the period"),
        ],
    )
}

/// Writes a `PeriodStatistics` row; `out` has the type's size.
pub fn write_statistics(s: &Statistics, out: &mut [u8]) {
    let mut put = Put { out, at: 0 };
    put.word(s.stamp_ns);
    for value in s.period.iter().chain(&s.compute).chain(&s.lateness) {
        put.word(value.to_bits());
    }
    put.word(s.load.to_bits());
    put.word(s.executed);
    put.word(s.skipped);
    put.word(s.overruns);
}

/// Writes a `ComponentStatus` row.
pub fn write_status(stamp_ns: u64, state: &str, health: &str, fault: &str, out: &mut [u8]) {
    let mut put = Put { out, at: 0 };
    put.word(stamp_ns);
    put.text(state, 24);
    put.text(health, 24);
    put.text(fault, TEXT);
}

/// Writes a `SystemMessage`.
pub fn write_message(stamp_ns: u64, text: &str, out: &mut [u8]) {
    let mut put = Put { out, at: 0 };
    put.word(stamp_ns);
    put.text(text, TEXT);
}

/// Bytes of the largest payload of this interface.
pub const MAX_BYTES: usize = 8 + 2 * (8 + 24) + 8 + TEXT;

/// Bytes of a `SystemMessage`.
pub const MESSAGE_BYTES: usize = 8 + 8 + TEXT;

struct Put<'a> {
    out: &'a mut [u8],
    at: usize,
}

impl Put<'_> {
    fn bytes(&mut self, bytes: &[u8]) {
        if let Some(room) = self.out.get_mut(self.at..self.at + bytes.len()) {
            room.copy_from_slice(bytes);
        }
        self.at += bytes.len();
    }

    fn word(&mut self, word: u64) {
        self.bytes(&word.to_le_bytes());
    }

    /// Writes a text, cut at a character boundary; the tail stays zero.
    fn text(&mut self, text: &str, room: usize) {
        let cut = text.floor_char_boundary(room);
        self.word(cut as u64);
        let end = self.at + room;
        self.bytes(&text.as_bytes()[..cut]);
        if let Some(tail) = self.out.get_mut(self.at..end) {
            tail.fill(0);
        }
        self.at = end;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn rows_written_by_hand_decode_as_their_described_types() {
        let interface = interface();
        let status = interface.commands[GET_STATE].ret.clone().unwrap();
        assert_eq!(status.size(), MAX_BYTES);
        let mut row = vec![0xffu8; status.size()];
        write_status(7, "ACTIVE", "OK", &"ü".repeat(200), &mut row);
        let value = trocar_model::decode(&status, &row).unwrap();
        assert_eq!(value["state"], "ACTIVE");
        assert_eq!(value["fault"], "ü".repeat(124));

        let statistics = interface.commands[PERIOD_STATISTICS].ret.clone().unwrap();
        let mut row = vec![0u8; statistics.size()];
        let s = Statistics {
            stamp_ns: 1,
            period: [1e-3; 4],
            compute: [2e-6; 4],
            lateness: [3e-6; 3],
            load: 0.5,
            executed: 10,
            skipped: 2,
            overruns: 1,
        };
        write_statistics(&s, &mut row);
        let value = trocar_model::decode(&statistics, &row).unwrap();
        assert_eq!(value["overruns"], 1);
        assert_eq!(value["load"], 0.5);

        let message = interface.events[ERROR].payload.clone().unwrap();
        assert_eq!(message.size(), MESSAGE_BYTES);
    }
}
