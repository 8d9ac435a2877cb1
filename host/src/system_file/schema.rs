//! The JSON Schema of the system file, for editors: `trocar schema system`.
//!
//! Invariant: it lists exactly the keys `read.rs` reads (a test compares them).

use serde_json::{Value, json};

use super::read::{ISOLATIONS, MODELS, ON_FAILURE, POLICIES, RESUMES, WAKES};

/// JSON Schema (draft 2020-12) of a system file.
pub fn system_schema() -> Value {
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "trocar system file",
        "description": "Which processes, components and connections make a system. Keys named // are comments.",
        "type": "object",
        "required": ["version"],
        "additionalProperties": false,
        "properties": {
            "$schema": { "type": "string", "description": "Where this schema is, for editors." },
            "//": { "description": "A comment." },
            "version": { "const": 1, "description": "Version of the file format." },
            "machines": {
                "type": "object",
                "description": "Other machines by name, on which an agent keeps processes. For `trocar up`.",
                "properties": { "//": { "description": "A comment." } },
                "additionalProperties": { "$ref": "#/$defs/machine" }
            },
            "processes": {
                "type": "object",
                "description": "Processes by name. Left out: those the components name.",
                "properties": { "//": { "description": "A comment." } },
                "additionalProperties": { "$ref": "#/$defs/process" }
            },
            "components": {
                "type": "object",
                "description": "Components by path: process/component.",
                "properties": { "//": { "description": "A comment." } },
                "additionalProperties": { "$ref": "#/$defs/component" }
            },
            "connections": {
                "type": "array",
                "description": "Who uses what of whom.",
                "items": { "$ref": "#/$defs/connection" }
            },
            "scenarios": { "type": "object", "description": "Not part of this version: leave it empty.", "maxProperties": 0 }
        },
        "$defs": {
            "machine": machine(),
            "process": process(),
            "memory": memory(),
            "restart": restart(),
            "component": component(),
            "execution": execution(),
            "connection": connection(),
            "queue": queue()
        }
    })
}

/// Schema of another machine.
fn machine() -> Value {
    json!({
        "type": "object",
        "required": ["agent"],
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "agent": { "type": "string", "description": "Address of its agent, as `trocar agent` prints it: https://HOST:PORT, or of this machine 127.0.0.1:PORT." }
        }
    })
}

/// Schema of a process.
fn process() -> Value {
    let policies = words(POLICIES);
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "machine": { "type": "string", "description": "The machine it runs on. Left out: that of `trocar up`. For `trocar up`." },
            "plugins": {
                "type": "array", "items": { "type": "string" },
                "description": "Directories of plugin files, relative to this file. The files go along to another machine; left out there: those of its agent."
            },
            "trust": {
                "type": "string", "pattern": "^(dev|allowlist:.+)$", "default": "dev",
                "description": "dev: your own and root's files. allowlist:FILE: only files whose sha256 the file lists (relative to this file)."
            },
            "listen": { "type": "string", "default": "127.0.0.1:0", "description": "Address it listens on; port 0 takes a free one. For `trocar up`." },
            "state": { "type": "string", "description": "Where it keeps its state, relative to this file, on another machine to its agent's folder of the system. Left out: in the user's state directory, or in that folder. For `trocar up`." },
            "env": { "type": "object", "additionalProperties": { "type": "string" }, "description": "Variables of its environment. For `trocar up`." },
            "restart": {
                "description": "What follows when it ends other than asked. For `trocar up`.",
                "default": "on_failure",
                "oneOf": [{ "enum": policies }, { "$ref": "#/$defs/restart" }]
            },
            "memory": { "$ref": "#/$defs/memory" },
            "allow_exec": { "type": "boolean", "default": false, "description": "Let its components start programs, as the user who starts it. Classes that do are refused otherwise." }
        }
    })
}

/// Schema of the bounds of a process's memory.
fn memory() -> Value {
    json!({
        "type": "object",
        "additionalProperties": false,
        "description": "How much memory it may use. For `trocar up`.",
        "properties": {
            "//": { "description": "A comment." },
            "warn_mib": { "type": "integer", "minimum": 1, "description": "It is listed with a warning while it has more than this in use, MiB." },
            "limit_mib": { "type": "integer", "minimum": 1, "description": "It gets no more memory of its own than this, MiB: asking for more ends it, and the restart policy says what follows." }
        }
    })
}

/// Schema of a restart policy with numbers.
fn restart() -> Value {
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "max": { "type": "integer", "minimum": 0, "maximum": 1000, "default": 3, "description": "Restarts within within_s; after more it is FAILED." },
            "within_s": { "type": "number", "exclusiveMinimum": 0, "default": 10, "description": "Time over which restarts are counted, s." },
            "backoff_ms": { "type": "number", "exclusiveMinimum": 0, "default": 50, "description": "Pause before the second restart within that time, ms; twice as long before each further one. The first is at once." },
            "most_backoff_ms": { "type": "number", "exclusiveMinimum": 0, "default": 2000, "description": "Longest pause, ms." },
            "start_within_s": { "type": "number", "exclusiveMinimum": 0, "default": 60, "description": "Time from its spawn until it serves, s; then it is killed, which counts as an end." },
            "unheard_s": {
                "description": "It lives, but the GCM has not heard it, or a component of it has not come back, for this long, s: it is killed and started again. Left out: 10 s, or never when something in it moves something.",
                "oneOf": [{ "type": "number", "exclusiveMinimum": 0 }, { "enum": ["never"] }]
            }
        }
    })
}

/// Schema of a component.
fn component() -> Value {
    let resumes = words(RESUMES);
    let isolations = words(ISOLATIONS);
    json!({
        "type": "object",
        "required": ["class"],
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "class": { "type": "string", "description": "plugin/class, or the class alone where it is unique." },
            "config": { "type": "object", "description": "Configuration; what is left out takes the class's default. Relative paths in it are relative to this file, too, by `trocar run` and `up`; `apply` leaves them to the hosts that run." },
            "execution": { "$ref": "#/$defs/execution" },
            "start": { "type": "boolean", "default": true, "description": "Start it with the system." },
            "resume": { "enum": resumes, "default": "manual", "description": "When its process was started again: what moves something waits for Resume, or with auto goes on by itself. For `trocar up`." },
            "isolation": { "enum": isolations, "default": "none", "description": "process: a process of its own, PROCESS.COMPONENT, made like the one it is written under. For `trocar up`." }
        }
    })
}

/// Schema of where a component's thread comes from.
fn execution() -> Value {
    let models = words(MODELS);
    let on_failure = words(ON_FAILURE);
    let wakes = words(WAKES);
    json!({
        "type": "object",
        "description": "Where the component's thread comes from; what is left out takes the class's default.",
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "model": { "enum": models, "description": "What makes it step." },
            "rate_hz": { "type": "number", "exclusiveMinimum": 0, "description": "Steps per second, Hz." },
            "period_us": { "type": "number", "exclusiveMinimum": 0, "description": "Time between steps, µs; instead of rate_hz." },
            "phase_us": { "type": "number", "minimum": 0, "description": "Offset of its grid, µs; left out: by what feeds it." },
            "stream_of": { "type": "string", "description": "Runs in the stream of this component (process/component)." },
            "inside": { "type": "string", "description": "Runs inside the step of this component (process/component): before it, or after it with model exec_out." },
            "priority": { "type": "integer", "minimum": 1, "maximum": 99, "description": "SCHED_FIFO priority." },
            "cpus": { "type": "array", "items": { "type": "integer", "minimum": 0 }, "description": "CPUs it may run on." },
            "catch_up": { "type": "integer", "minimum": 0, "maximum": 1000, "default": 0, "description": "Late periods that are made up for without pause, at most; 0: they are skipped. All are counted." },
            "threads": { "type": "integer", "minimum": 1, "maximum": 64, "default": 1, "description": "Threads that share the work of a stream, set where it begins." },
            "max_step_ms": { "type": "number", "minimum": 0.1, "default": 50, "description": "Longest stay inside its own code before a component without a period is UNRESPONSIVE, ms." },
            "history": { "type": "integer", "minimum": 3, "maximum": 65536, "default": 256, "description": "Rows its state table keeps." },
            "on_failure": { "enum": on_failure, "default": "stop_branch", "description": "What happens behind a filter of a stream that failed: nothing more comes, or frames pass it unchanged." },
            "wake": { "enum": wakes, "description": "How its thread is told that something has come: it is woken, or looks at each period; left out: it looks up to a period of 10 ms." }
        }
    })
}

/// Schema of a connection.
fn connection() -> Value {
    json!({
        "type": "object",
        "required": ["client", "server"],
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "client": { "type": "string", "description": "Input or required interface: process/component/port." },
            "server": { "type": "string", "description": "Output or provided interface: process/component/port." },
            "queue": {
                "description": "\"latest\", or a bounded queue.",
                "oneOf": [{ "const": "latest" }, { "$ref": "#/$defs/queue" }]
            },
            "max_age_ms": { "type": "number", "exclusiveMinimum": 0, "description": "Older samples are stale, ms." },
            "deadline_ms": { "type": "number", "exclusiveMinimum": 0, "description": "Default deadline of waiting calls, ms; goals that were only sent and waited longer are not carried out." },
            "mailbox": { "type": "integer", "minimum": 1, "maximum": 65536, "description": "Depth of the queue of commands or events." },
            "adapt": { "type": "boolean", "default": false, "description": "Copy by name when the layouts differ." },
            "delay": { "type": "boolean", "default": false, "description": "The client may step before the server in a period of both and take its samples one period later: cuts a circle of components." },
            "carrier": { "type": "string", "description": "Pins how data travel: inline, heap (within a process), memfd (between two of one machine, and within one process where it is pinned) or net (between two of any machines); left out: the best there is." }
        }
    })
}

/// Schema of a bounded queue.
fn queue() -> Value {
    json!({
        "type": "object",
        "required": ["fifo"],
        "additionalProperties": false,
        "properties": {
            "//": { "description": "A comment." },
            "fifo": { "type": "integer", "minimum": 1, "maximum": 65536, "description": "Depth in samples." },
            "drop_oldest": { "type": "boolean", "default": false, "description": "When full: overwrite the oldest instead of dropping the newest." }
        }
    })
}

/// The words of a table, in its order.
fn words<T>(table: &[(&'static str, T)]) -> Vec<&'static str> {
    table.iter().map(|(name, _)| *name).collect()
}
