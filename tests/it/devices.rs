//! The plugins of the product as a newcomer drives them: the built host, `trocar`, real grpcurl, a browser's
//! requests.
//!
//! Promise: robot, OCT, cameras, vision filters, displays and filters do from outside what `trocar describe`
//! says of them, and each wrong value is refused with what is wrong and what to do.

mod filters;
mod lines;
mod oct;
mod robot;
mod video;
mod vision;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Output, Trocar, World, eventually, repository};

const OK: i32 = 0;
const REFUSED: i32 = 1;

/// A host with plugins, and what people aim at it.
struct Site {
    grpc: Grpcurl,
    world: World,
    /// Ends when dropped.
    process: HostProcess,
}

impl Site {
    /// One host that takes these plugins from its directory.
    fn with(plugins: &[&str]) -> Site {
        let world = World::with_plugins(plugins);
        // `pipe_source`, `lines_source` and `lines_sink` start programs.
        let process = HostProcess::start_with(&world, "host", &["--allow-exec"]);
        let site = Site { grpc: process.grpcurl(), world, process };
        eventually("the plugins are listed", || {
            let listed = site.grpc.plugins().len();
            if listed >= plugins.len() { Ok(()) } else { Err(format!("{listed} of {}", plugins.len())) }
        });
        site
    }

    fn trocar(&self) -> Trocar {
        Trocar::at(&self.world, self.process.address())
    }

    /// `trocar call PATH ARG`.
    fn call(&self, path: &str, arg: &Value) -> Output {
        self.trocar().run(&["call", path, &arg.to_string()])
    }

    /// `trocar wait EVENT --call PATH --arg ARG`: the event's value, which the call brings about.
    fn event_of(&self, event: &str, path: &str, arg: &Value) -> Value {
        let mut words = vec!["wait", event, "--deadline", "60s", "--json", "--call", path];
        let arg = arg.to_string();
        if arg != "null" {
            words.extend(["--arg", &arg]);
        }
        let ended = self.trocar().run(&words);
        let value = ended.json()["value"].clone();
        // An event that says false is no success of what was called.
        ended.ends_with(if value == json!(false) { REFUSED } else { OK });
        value
    }

    /// Checks that a command is refused over gRPC, for this reason and with these words.
    #[track_caller]
    fn refuses(&self, path: &str, arg: &Value, reason: &str, words: &str) {
        let refused = self.grpc.refused("InteractService/Invoke", json!({ "path": path, "json": arg }));
        assert!(refused.reason == reason && refused.message.contains(words), "{path} {arg}: {refused}");
    }

    /// Checks that settings are refused over gRPC, for this reason and with these words, and that none of
    /// them holds.
    #[track_caller]
    fn unfit(&self, component: &str, config: &Value, reason: &str, words: &str) {
        let before = self.grpc.component(component)["config"].clone();
        let body = json!({ "path": component, "config": config });
        let refused = self.grpc.refused("GcmService/Configure", body);
        assert!(refused.reason == reason && refused.message.contains(words), "{config}: {refused}");
        assert_eq!(self.grpc.component(component)["config"], before, "{config}");
    }

    fn configure(&self, component: &str, config: &Value) {
        self.grpc.ok("GcmService/Configure", json!({ "path": component, "config": config }));
    }

    /// The newest row of a component's state table.
    fn row(&self, component: &str) -> Value {
        self.grpc.ok("InteractService/Read", json!({ "path": component }))["json"].clone()
    }

    /// Waits until a column of that row, by its JSON pointer, is as wanted.
    fn until(&self, component: &str, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        eventually(&format!("{component}: {what}"), || {
            let row = self.row(component);
            if wanted(&row) { Ok(row) } else { Err(row.to_string()) }
        })
    }
}

#[test]
fn every_class_of_the_product_has_its_line_in_the_docs() {
    let plugins = [
        "bscan",
        "display",
        "eyerobot",
        "filters",
        "force_sensor",
        "lines",
        "oct",
        "picture_writer",
        "sine",
        "stereo",
        "stereo_depth",
        "vision_filters",
    ];
    let site = Site::with(&plugins);
    let read = |name: &str| std::fs::read_to_string(repository().join("docs").join(name)).unwrap();
    let docs = format!("{}{}", read("COMPONENTS.md"), read("OCT.md"));
    let classes = site.grpc.classes("host");
    assert!(classes.len() > plugins.len(), "{classes:?}");
    for class in classes {
        let short = class.rsplit('/').next().unwrap();
        let there = [format!("`{short}`"), format!("/{short}`")].iter().any(|name| docs.contains(name));
        assert!(there, "{class} is in neither docs/COMPONENTS.md nor docs/OCT.md");
    }
}

/// Asks a port for a page as a program does that knows nothing of gRPC; the connection stays open.
fn request(address: &str, page: &str) -> BufReader<TcpStream> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    write!(stream, "GET {page} HTTP/1.0\r\nHost: {address}\r\n\r\n").unwrap();
    BufReader::new(stream)
}

/// The status line of an answer, and its headers by small letters.
fn head(answer: &mut BufReader<TcpStream>) -> (String, Vec<String>) {
    let lines: Vec<String> = answer.lines().map_while(Result::ok).take_while(|l| !l.is_empty()).collect();
    let (status, headers) = lines.split_first().unwrap();
    (status.clone(), headers.iter().map(|header| header.to_lowercase()).collect())
}

/// The next picture of a stream of JPEGs.
fn picture(answer: &mut BufReader<TcpStream>) -> Vec<u8> {
    let (boundary, headers) = head(answer);
    assert!(
        boundary.starts_with("--") && headers.iter().any(|h| h == "content-type: image/jpeg"),
        "{headers:?}"
    );
    let length = headers.iter().find_map(|h| h.strip_prefix("content-length: ")).unwrap();
    let mut bytes = vec![0; length.parse().unwrap()];
    answer.read_exact(&mut bytes).unwrap();
    // The end of its line.
    answer.read_exact(&mut [0; 2]).unwrap();
    bytes
}
