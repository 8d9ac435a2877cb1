//! `docs/INTERFACES.md` as text, from the tables.
//!
//! Invariant: everything a reader learns there is in the tables, so the page cannot say anything the check
//! does not.

use super::{CONTRACTS, Carries, Command, Contract, Interface, PAYLOADS, Payload};
use std::fmt::Write;

/// The whole page.
pub fn document() -> String {
    let mut out = String::from(HEAD);
    for contract in CONTRACTS {
        section(&mut out, contract);
    }
    out.push_str(PAYLOAD_HEAD);
    for payload in PAYLOADS {
        table(&mut out, payload);
    }
    out
}

const HEAD: &str = "# Standard device interfaces

<!-- Written from plugin-api/src/contracts: change the tables there, then run the tests with TROCAR_BLESS=1. -->

A component that fulfils one of these contracts can take the place of any other that does: clients are written against the
contract, not against a device. `trocar plugin check FILE --as arm` judges a plugin file,
`trocar_sdk::testing::assert_implements` a class in its own test, and the same table wrote this page. A class with several
devices has an interface of another name for each: `--interface arm_left` and `assert_implements_as` judge one of them.

Both judge the shape: interfaces, members, kinds, types, units, overflow policies, outputs and `safety`. What a device does is
said in prose, under \"The device\", and no look at a file can tell whether it is so: `plugin check` runs nothing.
`assert_behaves_as_arm` and `assert_behaves_as_camera` run the class on a bench and try each of those rules, and name the one
that it breaks; the other contracts have no such check. They see what a client sees: not whether a real joint is where its
encoder says, nor whether a stamp is the time of the exposure.

`latest_wins` is a command's overflow policy: of several that wait only the newest is carried out.

Values are SI. Times are ns of the host's monotonic clock; a stamp of 0 says that the value is not valid. Members marked
*optional* may be absent; where they exist they have the form given here. A class may offer more than its contract.
Standard payloads are those of `trocar_sdk::data`, described at the end.
";

const PAYLOAD_HEAD: &str = "
## Payloads

`list[T;n]` holds up to n items, `[T;n]` exactly n, `text[n]` up to n bytes of UTF-8; `m|rad` is m for a prismatic joint and
rad for a revolute one. `bool` is one byte: in Rust `Flag`, since not every byte is a valid Rust `bool`; `stamp` is `Stamp`,
`text[n]` is `Text<n>`, `list[T;n]` is `List<T, n>`.
";

// Writing to a String cannot fail, so the results of `write!` carry nothing here.
fn section(out: &mut String, c: &Contract) {
    let _ = write!(out, "\n## `{}`\n\n{} The class has `safety = \"{}\"`.\n", c.name, c.doc, c.safety);
    let _ =
        write!(out, "\n**Frames and times.** {}\n\n**Threads.** {}\n\nThe device:\n\n", c.frames, c.threads);
    for rule in c.rules {
        let _ = writeln!(out, "- {rule}");
    }
    let _ = match c.tried_by {
        "" => writeln!(out, "\nNothing tries these rules: they are for the tests of the device."),
        by => writeln!(out, "\n`trocar_sdk::testing::{by}` tries each of these rules on a bench."),
    };
    for interface in c.interfaces {
        self::interface(out, interface);
    }
    out.push_str("\n### Outputs\n\n| output | type | what |\n|---|---|---|\n");
    for o in c.outputs {
        let flows: Vec<String> = o.one_of.iter().map(super::Flows::text).collect();
        let _ =
            writeln!(out, "| `{}`{} | {} | {} |", o.name, optional(o.required), flows.join(" or "), o.doc);
    }
}

fn interface(out: &mut String, i: &Interface) {
    let _ = write!(out, "\n### Interface `{}`{}\n\n{}\n", i.name, optional(i.required), i.doc);
    out.push_str("\n| member | kind | takes | gives | what |\n|---|---|---|---|---|\n");
    for c in i.commands {
        let Command { name, kind, .. } = c;
        let (takes, gives) = (carries(c.arg), carries(c.ret));
        let (mut kind, optional) = (kind.replace('_', " "), optional(c.required));
        if !c.overflow.is_empty() {
            let _ = write!(kind, ", {}", c.overflow);
        }
        let _ = writeln!(out, "| `{name}`{optional} | {kind} | {takes} | {gives} | {} |", c.doc);
    }
    for e in i.events {
        let payload = carries(e.payload);
        let _ = writeln!(out, "| `{}`{} | event | – | {payload} | {} |", e.name, optional(e.required), e.doc);
    }
}

fn optional(required: bool) -> &'static str {
    if required { "" } else { " *optional*" }
}

fn carries(c: Carries) -> String {
    match (c.ty, c.unit) {
        ("", _) => "–".to_string(),
        (ty, "") => format!("`{ty}`"),
        (ty, unit) => format!("`{ty}` {unit}"),
    }
}

fn table(out: &mut String, p: &Payload) {
    let _ = write!(out, "\n### `{}`\n\n{}\n\n", p.name, p.doc);
    if p.repr.is_empty() {
        out.push_str("| field | type | unit | what |\n|---|---|---|---|\n");
        for f in p.fields {
            let unit = f.unit.replace('|', "\\|");
            let _ = writeln!(out, "| `{}` | `{}` | {unit} | {} |", f.name, f.ty, f.doc);
        }
    } else {
        let values: Vec<String> =
            p.values.iter().map(|(name, value)| format!("`{name}` = {value}")).collect();
        let _ = writeln!(out, "A {}: {}.", p.repr, values.join(", "));
    }
}
