//! Values that the program shows of a system: plain, independent of the wire.
//!
//! Invariant: `--json` prints exactly these structs, so their fields are part of the program's interface;
//! every number has its unit in its name.

use serde::Serialize;
use serde_json::Value;

/// One answer of List.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct SystemView {
    pub(super) revision: u64,
    pub(super) processes: Vec<ProcessView>,
    pub(super) components: Vec<ComponentView>,
    pub(super) connections: Vec<ConnectionView>,
    /// Sentences about the system as a whole.
    pub(super) warnings: Vec<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ProcessView {
    pub(super) name: String,
    /// ATTACHED, LOST, RESTARTING or FAILED.
    pub(super) state: String,
    pub(super) epoch: u64,
    pub(super) endpoint: String,
    /// Kind of a guest; empty for other processes.
    pub(super) guest: String,
    pub(super) pid: u32,
    /// Full names, `plugin/class`.
    pub(super) classes: Vec<String>,
    /// Last end of the process, as its supervisor reported it; "" when it never ended.
    pub(super) last_exit: String,
    /// Number of times its supervisor started it again.
    pub(super) restarts: u32,
    /// Warnings of the process about itself.
    pub(super) warnings: Vec<String>,
    /// True: nothing new can be made or connected in it, as the last warning says.
    pub(super) unfit: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ComponentView {
    /// `process/component`.
    pub(super) path: String,
    pub(super) class: String,
    /// The version of the plugin it was made of.
    pub(super) plugin_version: String,
    pub(super) state: String,
    pub(super) health: String,
    /// Reason why it is in FAULT.
    pub(super) fault: String,
    pub(super) config: Value,
    pub(super) execution: ExecutionView,
    /// none, sensor or actuator.
    pub(super) safety: String,
    pub(super) stats: StatsView,
    /// False: its process gave no figures, and `stats` says nothing.
    #[serde(skip)]
    pub(super) is_measured: bool,
    pub(super) warnings: Vec<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ExecutionView {
    pub(super) model: String,
    /// 0 = not periodic.
    pub(super) period_ns: u64,
    /// As it was set; null = by what feeds it.
    pub(super) phase_ns: Option<u64>,
    pub(super) stream_of: String,
    pub(super) inside: String,
    pub(super) priority: u32,
    pub(super) cpus: Vec<u32>,
    /// Late periods made up for, at most.
    pub(super) catch_up: u32,
    /// Threads of its stream, its own included; 0 = not set.
    pub(super) threads: u32,
    /// 0 = not set.
    pub(super) max_step_ns: u64,
    /// Rows of the state table; 0 = the default.
    pub(super) history: u32,
    /// stop_branch or bypass; "" = not set.
    pub(super) on_failure: String,
    /// signal or poll; "" = not set.
    pub(super) wake: String,
    /// Thread that it runs in, in words.
    pub(super) thread: String,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct StatsView {
    pub(super) executed: u64,
    pub(super) skipped: u64,
    pub(super) overruns: u64,
    pub(super) lateness_p50_ns: u64,
    pub(super) lateness_p99_ns: u64,
    pub(super) lateness_max_ns: u64,
    pub(super) period_avg_ns: u64,
    pub(super) compute_avg_ns: u64,
    pub(super) compute_max_ns: u64,
    /// Compute time over period, 0–1.
    pub(super) load: f64,
    /// SCHED_FIFO was granted.
    pub(super) realtime: bool,
    pub(super) commands: u64,
    pub(super) commands_rejected: u64,
    pub(super) events_dropped: u64,
    /// Its place in its period; absent without a grid of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) phase_ns: Option<u64>,
    /// True: the phase was not set.
    pub(super) phase_auto: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ConnectionView {
    pub(super) id: u64,
    pub(super) client: String,
    pub(super) server: String,
    pub(super) carrier: String,
    pub(super) options: OptionsView,
    pub(super) passed: u64,
    pub(super) dropped: u64,
    /// Samples a newer one took the place of where only the newest is taken; none of `dropped`.
    pub(super) skipped: u64,
    pub(super) bytes: u64,
    pub(super) latency_p50_ns: u64,
    pub(super) latency_p99_ns: u64,
    /// Commands and events that a full queue did not take; `dropped` counts them too.
    pub(super) rejected: u64,
    /// Samples, or commands and as many events, that may wait.
    pub(super) depth: u64,
    /// The most commands or events that ever waited at once.
    pub(super) high_water: u64,
    /// Commands that were only sent, ran and failed.
    pub(super) failed: u64,
    /// Commands that were only sent, and events, that never ran.
    pub(super) unexecuted: u64,
    /// Way in which each end is told that something has come: signal or poll; "" = it is called, or
    /// nothing comes.
    pub(super) client_wake: String,
    pub(super) server_wake: String,
    /// The line between its ends, where they are on two machines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) line: Option<LineView>,
    /// Its halves, where its ends are in two processes: the client's, then the server's.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) proxies: Vec<ProxyView>,
}

/// Figures of the line between two ends, and of what passes on it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct LineView {
    /// Samples, answers, events and rows that left the server's end, and that are at the client's.
    pub(super) sent: u64,
    pub(super) came: u64,
    pub(super) round_trip_ns: u64,
    /// The server's clock less the client's, and the most by which that is wrong.
    pub(super) clock_offset_ns: i64,
    pub(super) clock_bound_ns: u64,
}

impl LineView {
    /// Returns its figures as a sentence.
    pub(super) fn figures(&self) -> String {
        let ahead = if self.clock_offset_ns < 0 { "behind" } else { "ahead of" };
        format!(
            "line: there and back {}, sent {}, came {}; the server's clock is {} {ahead} the client's, ± {}",
            super::units::time(self.round_trip_ns),
            self.sent,
            self.came,
            super::units::time(self.clock_offset_ns.unsigned_abs()),
            super::units::time(self.clock_bound_ns),
        )
    }
}

/// One half of a connection between two processes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ProxyView {
    pub(super) process: String,
    /// CLIENT or SERVER.
    pub(super) end: String,
    pub(super) linked: bool,
    /// Why it is not linked; "" when it is.
    pub(super) why_not: String,
    /// Number of the link, higher each time; 0 = not linked.
    pub(super) epoch: u64,
    pub(super) carrier: String,
}

/// Options of a connection; an absent one is the default of the ports.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct OptionsView {
    /// Samples; 0 = latest value.
    pub(super) fifo: Option<u32>,
    pub(super) drop_oldest: bool,
    /// Older samples are stale.
    pub(super) max_age_ns: Option<u64>,
    pub(super) deadline_ns: Option<u64>,
    /// Commands or events.
    pub(super) mailbox: Option<u32>,
    pub(super) adapt: bool,
    /// The client may step before the server on their grid.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(super) delay: bool,
    /// Carrier that it was pinned to; "" = none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(super) carrier: String,
}

impl ProcessView {
    /// Returns the address of the process, or the kind of a guest, which has no address.
    pub(super) fn place(&self) -> String {
        match self.guest.as_str() {
            "" => self.endpoint.clone(),
            guest => format!("guest: {guest}"),
        }
    }
}

impl ComponentView {
    /// The state with its reason, as one word or phrase.
    pub(super) fn rate(&self) -> String {
        match (self.execution.stream_of.as_str(), self.execution.inside.as_str()) {
            ("", "") if self.execution.period_ns > 0 => {
                super::units::rate_of_period(self.execution.period_ns)
            }
            ("", "") => self.execution.model.clone(),
            ("", owner) if self.execution.model == "exec_out" => format!("after {owner}"),
            ("", owner) => format!("inside {owner}"),
            (owner, _) => format!("stream of {owner}"),
        }
    }
}

impl ComponentView {
    /// The rate, and where in its period it steps: "1000 Hz +500 µs".
    pub(super) fn runs(&self) -> String {
        match self.stats.phase_ns.filter(|ns| *ns > 0) {
            Some(ns) => format!("{} +{}", self.rate(), super::units::time(ns)),
            None => self.rate(),
        }
    }

    /// Returns its place in its period, and whether that was set; empty without a grid of its own.
    pub(super) fn phase(&self) -> String {
        let who = if self.stats.phase_auto { "auto" } else { "as set" };
        let said = |ns| format!("{} of each period ({who})", super::units::time(ns));
        self.stats.phase_ns.map(said).unwrap_or_default()
    }
}

impl ConnectionView {
    /// Component of the client end.
    pub(super) fn client_component(&self) -> &str {
        component_of(&self.client)
    }

    /// Component of the server end.
    pub(super) fn server_component(&self) -> &str {
        component_of(&self.server)
    }

    /// False: no process gave figures of it, and those here say nothing. Who gives some names the carrier.
    pub(super) fn is_measured(&self) -> bool {
        !self.carrier.is_empty() || self.depth > 0 || self.passed > 0
    }

    /// Returns the counts of what was sent over the connection.
    pub(super) fn figures(&self) -> String {
        let mut text = format!("passed {}, dropped {}, queue {}", self.passed, self.dropped, self.depth);
        if self.skipped > 0 {
            text.push_str(&format!(", skipped {} (newest only)", self.skipped));
        }
        for (figure, what) in [
            (self.high_water, "at most"),
            (self.rejected, "rejected"),
            (self.failed, "failed"),
            (self.unexecuted, "never ran"),
        ] {
            if figure > 0 {
                text.push_str(&format!(", {what} {figure}"));
            }
        }
        text
    }

    /// Returns how its ends are told that something has come; empty where none is told.
    pub(super) fn wakes(&self) -> String {
        let said = [("client", &self.client_wake), ("server", &self.server_wake)];
        let said = said.iter().filter(|(_, wake)| !wake.is_empty());
        said.map(|(end, wake)| format!("wake of the {end}: {wake}")).collect::<Vec<_>>().join(", ")
    }

    /// Returns how its data travel, or that they do not.
    pub(super) fn way(&self) -> String {
        match self.not_linked() {
            Some(_) => "not linked".to_owned(),
            None if self.carrier.is_empty() => "-".to_owned(),
            None => self.carrier.clone(),
        }
    }

    /// Returns why the halves of a connection between processes are not linked.
    pub(super) fn not_linked(&self) -> Option<&str> {
        self.proxies.iter().find(|p| !p.linked).map(|p| p.why_not.as_str())
    }

    /// `out → in`, without the components.
    pub(super) fn ports(&self) -> String {
        format!("{} → {}", port_of(&self.server), port_of(&self.client))
    }
}

fn component_of(port: &str) -> &str {
    port.rsplit_once('/').map_or(port, |(component, _)| component)
}

fn port_of(port: &str) -> &str {
    port.rsplit_once('/').map_or(port, |(_, port)| port)
}

/// One answer of Describe: what the path names, and what lies under it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct DescribeView {
    pub(super) path: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) process: Option<ProcessView>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) component: Option<ComponentView>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) class: Option<ClassView>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) ports: Option<PortsView>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) connections: Vec<ConnectionView>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) classes: Vec<ClassView>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ClassView {
    /// `plugin/class`.
    pub(super) name: String,
    pub(super) version: String,
    pub(super) hash: String,
    pub(super) doc: String,
    /// none, sensor or actuator.
    pub(super) safety: String,
    pub(super) hardware: bool,
    /// none, allowed or refused.
    pub(super) programs: String,
    pub(super) execution: ExecutionView,
    pub(super) execution_limits: ExecutionLimitsView,
    pub(super) config_schema: Value,
    pub(super) ports: PortsView,
}

/// The executions a class is made for.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ExecutionLimitsView {
    /// Empty = any.
    pub(super) models: Vec<String>,
    /// Hz; none = no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) min_rate_hz: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) max_rate_hz: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct PortsView {
    pub(super) inputs: Vec<StreamView>,
    pub(super) outputs: Vec<StreamView>,
    pub(super) required: Vec<RequiredView>,
    pub(super) provided: Vec<ProvidedView>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) state: Option<TypeView>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct StreamView {
    pub(super) name: String,
    pub(super) doc: String,
    #[serde(rename = "type")]
    pub(super) ty: TypeView,
    /// Format of the bytes behind a frame's header; "" for plain samples.
    pub(super) format: String,
    /// `truth` or `sim`; "" for others.
    pub(super) tag: String,
    pub(super) optional: bool,
    /// Default queue depth, samples; 0 = latest value.
    pub(super) fifo: u32,
    /// Every component has it: see `trocar_model::TAPS`.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(super) tap: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ProvidedView {
    pub(super) name: String,
    pub(super) doc: String,
    pub(super) tag: String,
    pub(super) commands: Vec<MemberView>,
    pub(super) events: Vec<MemberView>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct RequiredView {
    pub(super) name: String,
    pub(super) doc: String,
    pub(super) optional: bool,
    pub(super) functions: Vec<MemberView>,
    pub(super) handlers: Vec<MemberView>,
}

/// A command, event, function or handler.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct MemberView {
    pub(super) name: String,
    /// void, write, read, qualified read, void-return, write-return, event, function or handler.
    pub(super) kind: String,
    pub(super) doc: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) arg: Option<ArgView>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) returns: Option<ArgView>,
    pub(super) optional: bool,
    /// A handler that runs inside the emitting call where both ends share a thread.
    pub(super) direct: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ArgView {
    pub(super) name: String,
    pub(super) doc: String,
    #[serde(rename = "type")]
    pub(super) ty: TypeView,
    pub(super) unit: String,
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct TypeView {
    pub(super) name: String,
    pub(super) hash: String,
    pub(super) bytes: u32,
    pub(super) doc: String,
    /// Fields of a struct, or of each item where it is many of them.
    pub(super) fields: Vec<FieldView>,
    /// Names of an enumeration.
    pub(super) values: Vec<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct FieldView {
    pub(super) name: String,
    #[serde(rename = "type")]
    pub(super) ty: String,
    pub(super) unit: String,
    pub(super) doc: String,
    pub(super) frame: String,
    /// Fields of a struct, or of each item where it is many of them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) fields: Vec<FieldView>,
    /// Names of an enumeration.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) values: Vec<String>,
}

/// One plugin file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct PluginView {
    pub(super) process: String,
    pub(super) file: String,
    pub(super) name: String,
    pub(super) version: String,
    pub(super) hash: String,
    pub(super) abi: String,
    pub(super) built_with: String,
    pub(super) doc: String,
    pub(super) classes: Vec<String>,
    pub(super) loaded: bool,
    pub(super) warnings: Vec<String>,
    /// Reason code; "" = not refused.
    pub(super) refused_reason: String,
    pub(super) refused: String,
}

/// The answer of a call.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ReplyView {
    /// False: queued only.
    pub(super) executed: bool,
    pub(super) value: Option<Value>,
    pub(super) unit: String,
    pub(super) stamp_ns: u64,
    pub(super) age_ns: u64,
}

/// One row of a state table, or the newest sample of an output.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct RowView {
    pub(super) path: String,
    pub(super) value: Value,
    pub(super) stamp_ns: u64,
    pub(super) age_ns: u64,
    pub(super) tick: u64,
    pub(super) frame_bytes: u64,
}

/// Result of WaitFor.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct WaitView {
    pub(super) path: String,
    /// State of the component.
    pub(super) state: String,
    pub(super) health: String,
    /// Payload of an event; absent when a state was waited for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) value: Option<Value>,
    /// When the event was sent; 0 = a state was waited for.
    pub(super) stamp_ns: u64,
}

/// One item of a subscription.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ItemView {
    pub(super) path: String,
    /// state, event or stream.
    pub(super) kind: String,
    pub(super) value: Value,
    pub(super) stamp_ns: u64,
    pub(super) seq: u64,
    pub(super) skipped: u64,
}

/// One change of the graph.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ChangeView {
    pub(super) revision: u64,
    /// Incarnation of the GCM; revisions of two terms cannot be compared.
    pub(super) term: u64,
    /// True: this is the whole graph.
    pub(super) snapshot: bool,
    pub(super) processes: Vec<ProcessView>,
    pub(super) components: Vec<ComponentView>,
    pub(super) connections: Vec<ConnectionView>,
    pub(super) removed_processes: Vec<String>,
    pub(super) removed_components: Vec<String>,
    pub(super) removed_connections: Vec<u64>,
    /// Place to go on from: `trocar watch --after CURSOR`.
    pub(super) cursor: String,
}

impl ChangeView {
    /// Returns one line per thing that is new, different or gone.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for p in &self.processes {
            let classes = super::units::count(p.classes.len() as u64, "class");
            lines.push(format!("process {}  {}  {classes}", p.name, p.state));
        }
        for c in &self.components {
            let fault = if c.fault.is_empty() { String::new() } else { format!("  {}", c.fault) };
            lines.push(format!("component {}  {}  {}  {}{fault}", c.path, c.class, c.state, c.health));
        }
        lines.extend(
            self.connections.iter().map(|c| format!("connection {}  {} → {}", c.id, c.server, c.client)),
        );
        lines.extend(self.removed_connections.iter().map(|id| format!("connection {id}  gone")));
        lines.extend(self.removed_components.iter().map(|path| format!("component {path}  gone")));
        lines.extend(self.removed_processes.iter().map(|name| format!("process {name}  gone")));
        lines
    }
}

/// One line of a log.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct LogView {
    /// Ns since the Unix epoch.
    pub(super) wall_ns: u64,
    pub(super) level: String,
    pub(super) path: String,
    pub(super) target: String,
    pub(super) message: String,
    pub(super) skipped: u64,
}
