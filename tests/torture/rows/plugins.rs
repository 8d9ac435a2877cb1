//! Rows about plugin files: names that lead out of their directory.

use std::fs;
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;

use rustix::fs::inotify::{self, CreateFlags, WatchFlags};
use rustix::io::Errno;
use serde_json::json;
use tonic::Code;

use crate::book::Book;
use crate::clock::{Witness, eventually, now_ns, pause_ms};
use crate::files;
use crate::invariants::{Holdings, nothing_is_left};
use crate::program::Program;
use crate::rpc::{Refused, Rpc};
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[Row {
    name: "33",
    fault: "plugin names that lead out of their directory",
    when: When::Gate,
    run: names,
}];

/// A request with a bad name.
type Ask<'a> = dyn Fn() -> Result<(), Refused> + 'a;

/// Everything that is opened or read in a directory from now on.
struct Touches(OwnedFd);

impl Touches {
    fn of(dir: &std::path::Path) -> Result<Touches, String> {
        let watch = || {
            let fd = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
            inotify::add_watch(&fd, dir, WatchFlags::OPEN | WatchFlags::ACCESS)?;
            Ok(fd)
        };
        watch().map(Touches).map_err(|e: Errno| format!("inotify: {e}"))
    }

    fn so_far(&self) -> Vec<String> {
        let mut room = [MaybeUninit::uninit(); 4096];
        let mut reader = inotify::Reader::new(&self.0, &mut room);
        let mut all = Vec::new();
        while let Ok(event) = reader.next() {
            all.push(format!("{:?} {:?}", event.events(), event.file_name()));
        }
        all
    }
}

fn names(run: &Run, book: &mut Book) -> Result<(), String> {
    let world = World::new(&["sine"])?;
    let outside = world.path("outside");
    let file = "libtrocar_fixture_chaos.so";
    let from = files::plugin("fixture_chaos")?;
    fs::create_dir(&outside).and_then(|()| fs::copy(from, outside.join(file))).map_err(|e| e.to_string())?;
    symlink(outside.join(file), world.path("plugins").join("libtrocar_away.so"))
        .map_err(|e| e.to_string())?;
    symlink(format!("../outside/{file}"), world.path("plugins").join(file)).map_err(|e| e.to_string())?;
    let touched = Touches::of(&outside)?;
    let mut host = Program::host(&world, "a", None)?;
    let (rpc, witness) = (Rpc::at(&host.address), Witness::start());
    eventually("the class of the good plugin is offered", || {
        Ok(rpc.create("a/sine", "sine", json!({})).map(drop)?)
    })?;
    let held = Holdings::of(&[("a", host.pid())]);
    let there = outside.join(file);
    let there = there.to_string_lossy();
    let names = [
        "../../etc/passwd".to_owned(),
        "../outside/libtrocar_fixture_chaos.so".to_owned(),
        "../outside/libtrocar_fixture_chaos".to_owned(),
        "fixture-chaos/../../outside/chaos".to_owned(),
        "fixture-chaos/chaos".to_owned(),
        "away/chaos".to_owned(),
        "/etc/passwd".to_owned(),
        there.to_string(),
        "sine\0/../../outside".to_owned(),
        "..".to_owned(),
        "/".to_owned(),
        "x".repeat(10 << 10),
        "../".repeat(3 << 10),
        "\u{202e}enis".to_owned(),
        String::new(),
    ];
    let (mut took, mut wrong, mut tried) = (Vec::new(), Ok(()), 0);
    for _ in 0..run.times(1, 100) {
        for name in &names {
            let asks: [(&str, &Ask<'_>); 4] = [
                ("Create", &|| rpc.create("a/x", name, json!({}))),
                ("Create as", &|| rpc.create(&format!("a/{name}"), "sine", json!({}))),
                ("DescribePlugin", &|| rpc.plugin("a", name)),
                ("DescribePlugin in", &|| rpc.plugin(name, "libtrocar_sine.so")),
            ];
            for (verb, ask) in asks {
                if is_fine(verb, name) {
                    continue;
                }
                witness.forget();
                let began = now_ns();
                let answer = ask();
                took.push(witness.timed(began, now_ns(), 0.0));
                tried += 1;
                match answer {
                    Err(refused) if matches!(refused.code, Code::InvalidArgument | Code::NotFound) => {}
                    // It names the link itself, which is there and leads out.
                    Err(refused) if refused.reason == "PLUGIN_UNTRUSTED" => {}
                    other => {
                        let short: String = name.chars().take(60).collect();
                        wrong = Err(format!("{verb} {short:?}: {other:?}"));
                    }
                }
            }
        }
    }
    book.check("refused as no name, as none there is, or as a link that leads out", tried, wrong);
    book.times("answered", &took, 10.0);
    // Time for a directory to be looked at once more.
    pause_ms(500);
    let touches = touched.so_far();
    let none = if touches.is_empty() { Ok(()) } else { Err(touches.join(", ")) };
    book.check("no file outside was opened or read", tried, none);
    let maps = fs::read_to_string(format!("/proc/{}/maps", host.pid())).unwrap_or_default();
    let mapped = maps.lines().find(|line| line.contains("chaos") || line.contains("outside"));
    book.check("none is loaded", tried, mapped.map_or(Ok(()), |line| Err(line.to_owned())));
    let offered = rpc.brief()?.processes.iter().flat_map(|p| p.classes.clone()).collect::<Vec<_>>();
    let strange: Vec<_> = offered.iter().filter(|class| !class.starts_with("sine/")).collect();
    book.check(
        "no class of a link that leads out is offered",
        1,
        if strange.is_empty() { Ok(()) } else { Err(format!("{strange:?}")) },
    );
    let alive = rpc.start("a/sine").map_err(|e| e.to_string());
    book.check("the host goes on", 1, alive);
    book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    host.terminate()?;
    nothing_is_left(book, &world);
    Ok(())
}

/// No name asks for the first plugin there is, and no process for any: such requests are no bad ones.
fn is_fine(verb: &str, name: &str) -> bool {
    verb.starts_with("DescribePlugin") && name.is_empty()
}
