//! Time until another manager leads.

use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::json;
use trocar_tests::eventually;

use super::{Lab, is_attached, send};

/// The lease of 2 s, counted from the last beat that the others saw, and a look of theirs.
const BOUND: Duration = Duration::from_secs(3);

/// Time from `harm` until a change is answered by another manager.
fn another_leads(lab: &Lab, old: usize, harm: impl FnOnce(&Lab)) -> Duration {
    let others: Vec<usize> = (0..lab.gcms.len()).filter(|at| *at != old).collect();
    let began = Instant::now();
    harm(lab);
    let path = format!("left/made{}", began.elapsed().as_nanos());
    eventually("another manager makes a change", || {
        let ask = json!({ "path": path, "class": "Server" });
        let made = others.iter().any(|at| lab.grpc(*at).call("GcmService/Create", ask.clone()).is_ok());
        if made { Ok(()) } else { Err("no manager makes it") }
    });
    began.elapsed()
}

#[test]
fn another_manager_leads_soon() {
    let mut lab = Lab::new(3, 3);
    let _host = lab.host("left");
    let mut times = Vec::new();
    for _ in 0..5 {
        let old = lab.leader();
        let stopped = another_leads(&lab, old, |lab| send(lab.gcms[old].pid(), Signal::STOP));
        send(lab.gcms[old].pid(), Signal::CONT);
        let next = lab.leader();
        let grpc = lab.grpc(next);
        eventually("the host is attached", || is_attached(&grpc, "left"));
        let killed = another_leads(&lab, next, |lab| send(lab.gcms[next].pid(), Signal::KILL));
        lab.restart_manager(next);
        times.extend([stopped, killed]);
        lab.assert_runs_on(lab.leader(), "left");
    }
    // A look of a host, and the machine's own stalls, come on top of one or the other.
    times.sort();
    let (middle, most) = (times[times.len() / 2], times[times.len() - 1]);
    println!(
        "bench another manager leads: {times:.1?}, median {middle:.2?}, at most {most:.2?} (bound {BOUND:?})"
    );
    assert!(middle <= BOUND, "{times:?}");
}
