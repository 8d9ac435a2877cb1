//! `trocar describe PATH`: what a process, component, interface or class offers, with docs, units and kinds.
//!
//! Invariant: text and `--json` are made from the same `DescribeView`.

use std::fmt::Write as _;

use clap::Args;
use serde_json::Value;

use super::failure::{Done, Exit};
use super::session::Session;
use super::view::{
    ArgView, ClassView, ComponentView, ConnectionView, DescribeView, ExecutionLimitsView, ExecutionView,
    FieldView, MemberView, OptionsView, PortsView, ProxyView, StreamView, TypeView,
};
use super::{out, style, units};

/// Longest value of a setting shown, characters; `--json` shows all of it.
const VALUE: usize = 200;

/// Describes a process, component, interface, command or class.
#[derive(Args, Debug)]
pub(super) struct DescribeArgs {
    /// process[/component[/port[/member]]]; or a class: plugin/class, or the class alone.
    path: String,
    /// PATH is a class, also where a process or component of this name exists.
    #[arg(long)]
    class: bool,
}

pub(super) async fn run(args: DescribeArgs, session: &Session) -> Done {
    let view = session.describe(&args.path, args.class).await?;
    if session.json() {
        return session.print_json(&view);
    }
    out::text(&render(&view, style::stdout()));
    Ok(Exit::Ok)
}

fn render(view: &DescribeView, colour: bool) -> String {
    // The page of one port or member shows all of its types: a caller wants to use it.
    let deep = view.path.matches('/').count() >= 2;
    let mut page = Page { text: String::new(), colour, deep };
    if let Some(process) = &view.process {
        page.title(&format!("process {}", process.name), &process.state);
        page.line(
            1,
            &match process.guest.is_empty() {
                true => {
                    format!("pid {}, epoch {}, endpoint {}", process.pid, process.epoch, process.endpoint)
                }
                false => format!("pid {}, epoch {}, {}", process.pid, process.epoch, process.place()),
            },
        );
    }
    match (&view.component, &view.class) {
        // A path into the component asks about that part only.
        (Some(component), _) if view.path != component.path => page.title(&component.path, &component.state),
        (Some(component), class) => page.component(component, class.as_ref()),
        (None, Some(class)) => page.class(class),
        _ => {}
    }
    if let Some(ports) = &view.ports {
        page.ports(ports);
    } else if let (None, Some(class)) = (&view.component, &view.class) {
        page.ports(&class.ports);
    }
    let connections: Vec<_> = view.connections.iter().filter(|c| is_asked_about(&view.path, c)).collect();
    if !connections.is_empty() {
        page.heading("connections");
        for c in connections {
            let line = format!("{}  {} → {}  {}{}", c.id, c.server, c.client, c.way(), options(&c.options));
            page.line(1, line.trim_end());
            page.line(2, &c.figures());
            if !c.wakes().is_empty() {
                page.line(2, &c.wakes());
            }
            if let Some(line) = &c.line {
                page.line(2, &line.figures());
            }
            for p in &c.proxies {
                page.line(2, &half(p));
            }
        }
    }
    if !view.classes.is_empty() {
        page.heading("classes");
        for c in &view.classes {
            page.entry(1, &c.name, &c.doc);
        }
    }
    page.text
}

/// Tells whether a page about `path` shows this connection: that of a port shows its own ones, that of a
/// member none.
fn is_asked_about(path: &str, connection: &ConnectionView) -> bool {
    match path.matches('/').count() {
        0 | 1 => true,
        2 => connection.client == path || connection.server == path,
        _ => false,
    }
}

/// The text as it grows.
struct Page {
    text: String,
    colour: bool,
    /// Structs in structs are shown, too.
    deep: bool,
}

impl Page {
    fn line(&mut self, indent: usize, line: &str) {
        let _ = writeln!(self.text, "{:1$}{line}", "", indent * 2);
    }

    fn title(&mut self, title: &str, state: &str) {
        let title = style::paint(title, style::HEAD, self.colour);
        let state = style::paint(state, style::of_state(state), self.colour);
        self.line(0, format!("{title}  {state}").trim_end());
    }

    fn heading(&mut self, heading: &str) {
        let heading = style::paint(heading, style::HEAD, self.colour);
        self.line(0, &heading);
    }

    /// A name with its documentation dimmed behind it.
    fn entry(&mut self, indent: usize, what: &str, doc: &str) {
        let doc = style::paint(&out::one_line(doc), style::DIM, self.colour);
        self.line(indent, format!("{what}  {doc}").trim_end());
    }

    fn component(&mut self, c: &ComponentView, class: Option<&ClassView>) {
        self.title(&c.path, &c.state);
        if !c.fault.is_empty() {
            self.line(1, &format!("fault: {}", out::harmless(&c.fault)));
        }
        let mut made_of = format!("class {}", c.class);
        push(&mut made_of, ", version ", class.map_or("", |k| &k.version));
        self.entry(1, &made_of, class.map_or("", |k| &k.doc));
        let (rate, mut runs) = (c.rate(), c.rate());
        // The thread of a stream's member names its stream once more.
        push(&mut runs, ", ", if c.execution.thread == rate { "" } else { &c.execution.thread });
        push(&mut runs, ", at ", &c.phase());
        self.line(1, &format!("health {}, runs {runs}", c.health));
        self.execution(&c.execution, c.stats.realtime);
        let s = &c.stats;
        self.line(
            1,
            &format!(
                "steps {}, skipped {}, overruns {}, late p50 {} p99 {} max {}, compute avg {} max {}, load {}",
                s.executed,
                s.skipped,
                s.overruns,
                units::time(s.lateness_p50_ns),
                units::time(s.lateness_p99_ns),
                units::time(s.lateness_max_ns),
                units::time(s.compute_avg_ns),
                units::time(s.compute_max_ns),
                units::percent(s.load)
            ),
        );
        self.line(
            1,
            &format!(
                "commands {} ({} lost in full queues), events lost {}",
                s.commands, s.commands_rejected, s.events_dropped
            ),
        );
        for warning in &c.warnings {
            self.line(1, &format!("warning: {}", out::harmless(warning)));
        }
        self.config(&c.config, class.map_or(&Value::Null, |k| &k.config_schema));
    }

    fn class(&mut self, c: &ClassView) {
        self.title(&format!("class {}", c.name), "");
        self.entry(1, &format!("version {}", c.version), &c.doc);
        let device = if c.hardware { ", opens a device" } else { "" };
        let execution = ComponentView { execution: c.execution.clone(), ..ComponentView::default() };
        self.line(1, &format!("safety {}{device}, runs {}", c.safety, execution.rate()));
        self.execution(&c.execution, false);
        self.execution_limits(&c.execution_limits);
        match c.programs.as_str() {
            "allowed" => self.line(1, "starts programs, as its process allows"),
            "refused" => self.line(1, "starts programs, which its process does not allow: see --allow-exec"),
            _ => {}
        }
        self.config(&Value::Null, &c.config_schema);
    }

    /// Execution settings that are set. `realtime`: SCHED_FIFO was granted.
    fn execution(&mut self, e: &ExecutionView, realtime: bool) {
        let mut set = Vec::new();
        let mut add = |what: &str, value: String| set.push(format!("{what} {value}"));
        if !e.model.is_empty() {
            add("model", e.model.clone());
        }
        if let Some(phase_ns) = e.phase_ns {
            add("phase", units::time(phase_ns));
        }
        if e.priority > 0 {
            let granted = if realtime { " (granted)" } else { "" };
            add("priority", format!("{}{granted}", e.priority));
        }
        if !e.cpus.is_empty() {
            add("cpus", e.cpus.iter().map(u32::to_string).collect::<Vec<_>>().join(","));
        }
        if e.catch_up > 0 {
            add("catch-up", format!("{} periods", e.catch_up));
        }
        if e.threads > 0 {
            add("threads", e.threads.to_string());
        }
        if e.history > 0 {
            add("history", format!("{} rows", e.history));
        }
        if e.max_step_ns > 0 {
            add("max step", units::time(e.max_step_ns));
        }
        if !e.on_failure.is_empty() {
            add("on failure", e.on_failure.clone());
        }
        if !e.wake.is_empty() {
            add("wake", e.wake.clone());
        }
        if !set.is_empty() {
            self.line(1, &format!("execution: {}", set.join(", ")));
        }
    }

    /// Tells which executions the class is made for, where not every one is allowed.
    fn execution_limits(&mut self, l: &ExecutionLimitsView) {
        let models = if l.models.is_empty() { "any model".to_owned() } else { l.models.join(" or ") };
        let rates = match (l.min_rate_hz, l.max_rate_hz) {
            (Some(low), Some(high)) => format!("{low} to {high} Hz"),
            (Some(low), None) => format!("at least {low} Hz"),
            (None, Some(high)) => format!("at most {high} Hz"),
            (None, None) if l.models.is_empty() => return,
            (None, None) => "any rate".to_owned(),
        };
        self.line(1, &format!("made for: {models}, {rates}"));
    }

    /// Each setting: value (or default), unit, range, whether it may change while running, doc.
    fn config(&mut self, config: &Value, schema: &Value) {
        let Some(properties) = schema.get("properties").and_then(Value::as_object).filter(|p| !p.is_empty())
        else {
            if config.as_object().is_some_and(|c| !c.is_empty()) {
                self.heading("config");
                self.line(1, &units::cut(&config.to_string(), VALUE));
            }
            return;
        };
        self.heading("config");
        for (name, rules) in properties {
            let text = |key: &str| rules.get(key).and_then(Value::as_str).unwrap_or_default();
            let value = config.get(name).or_else(|| rules.get("default"));
            let shown = value.map_or_else(|| "(required)".to_owned(), |v| units::cut(&v.to_string(), VALUE));
            let mut line = format!("{name} = {shown}");
            push(&mut line, " ", text("unit"));
            if let Some(range) = range(rules.get("minimum"), rules.get("maximum")) {
                push(&mut line, "  ", &range);
            }
            if let Some(choices) = rules.get("enum").and_then(Value::as_array) {
                let choices = choices.iter().map(|c| c.as_str().map_or_else(|| c.to_string(), str::to_owned));
                push(&mut line, "  ", &choices.collect::<Vec<_>>().join(" | "));
            }
            if rules.get("live") == Some(&Value::Bool(true)) {
                line.push_str("  live");
            }
            self.entry(1, &line, text("description"));
        }
    }

    fn ports(&mut self, ports: &PortsView) {
        for (heading, streams) in [("inputs", &ports.inputs), ("outputs", &ports.outputs)] {
            // Every component has taps, and their types repeat those below. `--json` lists them, and so does
            // the page of a single tap.
            let asked_for = ports.provided.is_empty();
            let own: Vec<&StreamView> = streams.iter().filter(|s| asked_for || !s.tap).collect();
            if !own.is_empty() {
                self.heading(heading);
            }
            for s in own {
                self.stream(s);
            }
        }
        for r in &ports.required {
            let optional = if r.optional { " (optional)" } else { "" };
            self.heading(&format!("required interface {}{optional}", r.name));
            self.members(&r.doc, r.functions.iter().chain(&r.handlers));
        }
        for p in &ports.provided {
            let tag = if p.tag.is_empty() { String::new() } else { format!(" [{}]", p.tag) };
            self.heading(&format!("provided interface {}{tag}", p.name));
            self.members(&p.doc, p.commands.iter().chain(&p.events));
        }
        if let Some(state) = &ports.state {
            self.heading("state table row");
            self.of_type(1, state);
        }
    }

    fn stream(&mut self, s: &StreamView) {
        let mut line = format!("{}: {}", s.name, s.ty.name);
        push(&mut line, " + ", &s.format);
        if !s.tag.is_empty() {
            let _ = write!(line, " [{}]", s.tag);
        }
        if s.fifo > 0 {
            let _ = write!(line, "  fifo {}", s.fifo);
        }
        if s.optional {
            line.push_str("  optional");
        }
        self.entry(1, &line, &s.doc);
        self.of_type(2, &s.ty);
    }

    fn members<'m>(&mut self, doc: &str, members: impl Iterator<Item = &'m MemberView>) {
        if !doc.is_empty() {
            let doc = style::paint(&out::one_line(doc), style::DIM, self.colour);
            self.line(1, &doc);
        }
        for m in members {
            let arg = m.arg.as_ref().map(signature).unwrap_or_default();
            let mut line = format!("{}({arg})", m.name);
            if let Some(returns) = &m.returns {
                push(&mut line, " → ", &signature(returns));
            }
            push(&mut line, "  ", &m.kind);
            if m.optional {
                line.push_str(", optional");
            }
            if m.direct {
                line.push_str(", direct");
            }
            self.entry(1, &line, &m.doc);
            for arg in [&m.arg, &m.returns].into_iter().flatten() {
                if !arg.doc.is_empty() {
                    self.entry(2, &format!("{}:", arg.name), &arg.doc);
                }
                self.of_type(2, &arg.ty);
            }
        }
    }

    fn of_type(&mut self, indent: usize, ty: &TypeView) {
        self.fields(indent, &ty.fields);
        if !ty.values.is_empty() {
            self.line(indent, &ty.values.join(" | "));
        }
    }

    fn fields(&mut self, indent: usize, fields: &[FieldView]) {
        for f in fields {
            let mut line = format!(".{}: {}", f.name, f.ty);
            push(&mut line, " ", &bracketed(&f.unit));
            push(&mut line, " in frame ", &f.frame);
            push(&mut line, "  ", &f.values.join(" | "));
            self.entry(indent, &line, &f.doc);
            if self.deep {
                self.fields(indent + 1, &f.fields);
            }
        }
    }
}

/// One half of a connection between processes.
fn half(p: &ProxyView) -> String {
    let how = match p.linked {
        true => format!("linked, {}, epoch {}", p.carrier, p.epoch),
        false => format!("not linked: {}", out::harmless(&p.why_not)),
    };
    format!("{} half in {}: {how}", p.end.to_lowercase(), p.process)
}

/// Describes the options of a connection that are set.
fn options(o: &OptionsView) -> String {
    let mut said = String::new();
    match o.fifo {
        Some(0) => said.push_str(", latest"),
        Some(depth) => {
            let _ = write!(said, ", fifo {depth}{}", if o.drop_oldest { " (oldest dropped)" } else { "" });
        }
        None => {}
    }
    if let Some(ns) = o.max_age_ns {
        let _ = write!(said, ", max age {}", units::time(ns));
    }
    if let Some(ns) = o.deadline_ns {
        let _ = write!(said, ", deadline {}", units::time(ns));
    }
    if let Some(depth) = o.mailbox {
        let _ = write!(said, ", mailbox {depth}");
    }
    if o.adapt {
        said.push_str(", adapted");
    }
    if !o.carrier.is_empty() {
        let _ = write!(said, ", pinned to {}", o.carrier);
    }
    said
}

/// `name: type [unit] range`.
fn signature(arg: &ArgView) -> String {
    let mut text =
        if arg.name.is_empty() { arg.ty.name.clone() } else { format!("{}: {}", arg.name, arg.ty.name) };
    push(&mut text, " ", &bracketed(&arg.unit));
    let (min, max) = (arg.min.map(Value::from), arg.max.map(Value::from));
    push(&mut text, " ", &range(min.as_ref(), max.as_ref()).unwrap_or_default());
    text
}

fn bracketed(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!("[{unit}]") }
}

fn range(min: Option<&Value>, max: Option<&Value>) -> Option<String> {
    let number = |v: &Value| v.as_f64().map_or_else(|| v.to_string(), |n| n.to_string());
    match (min, max) {
        (Some(min), Some(max)) => Some(format!("{}…{}", number(min), number(max))),
        (Some(min), None) => Some(format!("≥ {}", number(min))),
        (None, Some(max)) => Some(format!("≤ {}", number(max))),
        (None, None) => None,
    }
}

fn push(line: &mut String, before: &str, text: &str) {
    if !text.is_empty() {
        line.push_str(before);
        line.push_str(text);
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::view::ProvidedView;
    use super::*;

    #[test]
    fn a_port_shows_its_own_connections_and_a_member_none() {
        let between = |client: &str, server: &str| ConnectionView {
            client: client.into(),
            server: server.into(),
            ..ConnectionView::default()
        };
        let connections = vec![between("a/x/in", "a/y/out"), between("a/z/in", "a/x/out")];
        let shown = |path: &str| {
            let view =
                DescribeView { path: path.into(), connections: connections.clone(), ..Default::default() };
            let text = render(&view, false);
            ["a/x/in", "a/x/out"].map(|port| text.contains(port))
        };
        assert_eq!(shown("a/x"), [true, true]);
        assert_eq!((shown("a/x/in"), shown("a/x/out")), ([true, false], [false, true]));
        assert_eq!(shown("a/x/in/member"), [false, false]);
    }

    #[test]
    fn a_command_shows_its_kind_unit_range_and_doc() {
        let ty = TypeView { name: "i32".into(), ..TypeView::default() };
        let arg = ArgView {
            name: "value".into(),
            ty,
            unit: "mm".into(),
            min: Some(0.0),
            max: Some(100.0),
            ..ArgView::default()
        };
        let write = MemberView {
            name: "Write".into(),
            kind: "write".into(),
            doc: "Sets the set point.".into(),
            arg: Some(arg),
            ..MemberView::default()
        };
        let provided =
            vec![ProvidedView { name: "Provided".into(), commands: vec![write], ..ProvidedView::default() }];
        let view = DescribeView {
            ports: Some(PortsView { provided, ..PortsView::default() }),
            ..DescribeView::default()
        };
        assert_eq!(
            render(&view, false),
            "provided interface Provided\n  Write(value: i32 [mm] 0…100)  write  Sets the set point.\n"
        );
    }

    #[test]
    fn execution_settings_options_direct_handlers_and_frames_are_shown() {
        let mut page = Page { text: String::new(), colour: false, deep: false };
        let execution = ExecutionView {
            model: "stream".into(),
            catch_up: 3,
            threads: 4,
            max_step_ns: 20_000_000,
            on_failure: "bypass".into(),
            priority: 80,
            ..ExecutionView::default()
        };
        page.execution(&execution, true);
        let want = "model stream, priority 80 (granted), catch-up 3 periods, threads 4, max step 20 ms, on failure bypass";
        assert_eq!(page.text, format!("  execution: {want}\n"));
        let set = OptionsView { fifo: Some(8), max_age_ns: Some(3_000_000), ..OptionsView::default() };
        assert_eq!(options(&set), ", fifo 8, max age 3 ms");
        let field = FieldView {
            name: "pose".into(),
            ty: "Pose".into(),
            frame: "retina".into(),
            ..FieldView::default()
        };
        let arg = ArgView {
            ty: TypeView { name: "Target".into(), fields: vec![field], ..TypeView::default() },
            ..ArgView::default()
        };
        let handler = MemberView {
            name: "moved".into(),
            kind: "handler".into(),
            direct: true,
            arg: Some(arg),
            ..MemberView::default()
        };
        let mut page = Page { text: String::new(), colour: false, deep: false };
        page.members("", std::iter::once(&handler));
        assert_eq!(page.text, "  moved(Target)  handler, direct\n    .pose: Pose in frame retina\n");
    }

    #[test]
    fn a_setting_shows_its_value_unit_range_and_whether_it_is_live() {
        let schema = json!({"properties": {"cutoff_hz": {
            "default": 50.0, "unit": "Hz", "minimum": 0.1, "maximum": 400, "live": true, "description": "Corner."}}});
        let mut page = Page { text: String::new(), colour: false, deep: false };
        page.config(&json!({"cutoff_hz": 20}), &schema);
        assert_eq!(page.text, "config\n  cutoff_hz = 20 Hz  0.1…400  live  Corner.\n");
    }

    #[test]
    fn a_setting_that_is_one_of_several_words_shows_them() {
        let schema = json!({"properties": {"format": {
            "default": "rgb8", "enum": ["rgb8", "yuyv"], "description": "How pixels lie."}}});
        let mut page = Page { text: String::new(), colour: false, deep: false };
        page.config(&Value::Null, &schema);
        assert_eq!(page.text, "config\n  format = \"rgb8\"  rgb8 | yuyv  How pixels lie.\n");
    }

    #[test]
    fn structs_in_structs_are_shown_where_one_port_is_asked_for_and_names_of_values_everywhere() {
        let field =
            |name: &str, ty: &str| FieldView { name: name.into(), ty: ty.into(), ..FieldView::default() };
        let kind = FieldView { values: vec!["PLANE".into(), "LINE".into()], ..field("kind", "FixtureKind") };
        let frame = FieldView { fields: vec![field("position", "[f64; 3]")], ..field("frame", "Pose") };
        let ty = TypeView { name: "Fixture".into(), fields: vec![kind, frame], ..TypeView::default() };
        let arg = ArgView { name: "guard".into(), doc: "usually a plane".into(), ty, ..ArgView::default() };
        let set =
            MemberView { name: "set".into(), kind: "write".into(), arg: Some(arg), ..MemberView::default() };
        let told = |path: &str| {
            let provided =
                ProvidedView { name: "f".into(), commands: vec![set.clone()], ..ProvidedView::default() };
            let ports = PortsView { provided: vec![provided], ..PortsView::default() };
            render(&DescribeView { path: path.into(), ports: Some(ports), ..DescribeView::default() }, false)
        };
        let short = "provided interface f\n  set(guard: Fixture)  write\n    guard:  usually a plane\n    \
                     .kind: FixtureKind  PLANE | LINE\n    .frame: Pose\n";
        assert_eq!(told("host/robot"), short);
        assert_eq!(told("host/robot/f/set"), format!("{short}      .position: [f64; 3]\n"));
    }

    #[test]
    fn what_runs_in_a_stream_says_so_once() {
        let mut page = Page { text: String::new(), colour: false, deep: false };
        let execution = ExecutionView {
            stream_of: "host/a".into(),
            thread: "stream of host/a".into(),
            ..ExecutionView::default()
        };
        page.component(&ComponentView { execution, ..ComponentView::default() }, None);
        assert!(page.text.contains("runs stream of host/a\n"), "{}", page.text);
    }
}
