//! What is asked of a small world, drawn from a seed.
//!
//! Invariant: pure; the same seed draws the same operations.

use fastrand::Rng;
use trocar::model::{Execution, ExecutionModel};

use super::super::{Call, Function};

pub(super) const SERVERS: [&str; 2] = ["s0", "s1"];
pub(super) const CLIENTS: [&str; 2] = ["c0", "c1"];

/// One change of the world.
#[derive(Clone, Debug)]
pub(super) enum Op {
    Create(&'static str, Box<Execution>),
    Remove(&'static str),
    /// Client's port, server's port, whether it may take another's place.
    Connect(String, String, bool),
    Disconnect(String, String),
    Start(&'static str),
    Stop(&'static str),
    Resume(&'static str),
    Reset(&'static str),
    /// Factor of a server.
    Configure(&'static str, f64),
}

/// What one seed asks: changes, and calls of each client meanwhile.
pub(super) struct Script {
    pub(super) executions: [Execution; 4],
    pub(super) changes: Vec<Op>,
    pub(super) calls: [Vec<Call>; 2],
}

impl Script {
    /// For whoever looks into a failure.
    pub(super) fn told(&self) -> String {
        let threads = SERVERS.iter().chain(&CLIENTS).zip(&self.executions);
        let threads = threads.map(|(n, e)| format!("{n}: {:?} {:?}{:?}", e.model, e.stream_of, e.inside));
        let changes = self.changes.iter().map(|op| format!("{op:?}"));
        threads.chain(changes).collect::<Vec<_>>().join("\n")
    }
}

pub(super) fn draw(seed: u64) -> Script {
    let mut rng = Rng::with_seed(seed);
    let executions = [server(&mut rng), server(&mut rng), client(&mut rng), client(&mut rng)];
    let changes = (0..rng.usize(15..30)).map(|_| change(&mut rng)).collect();
    let calls = [0, 1].map(|_| (0..rng.usize(6..16)).map(|_| call(&mut rng)).collect());
    Script { executions, changes, calls }
}

pub(super) fn own_thread() -> Execution {
    Execution { model: Some(ExecutionModel::OnSignal), ..Execution::default() }
}

fn server(rng: &mut Rng) -> Execution {
    match rng.u8(0..5) {
        0 => Execution { model: Some(ExecutionModel::None), ..Execution::default() },
        1 => grid(),
        2 => Execution { model: Some(ExecutionModel::Stream), ..Execution::default() },
        _ => own_thread(),
    }
}

/// A rider's host may not lead a stream, or may be passive: then it is refused, which is to be borne, too.
fn client(rng: &mut Rng) -> Execution {
    let inside =
        |model| Execution { model: Some(model), inside: Some("host/s0".into()), ..Execution::default() };
    match rng.u8(0..7) {
        0 => Execution { stream_of: Some("host/s0".into()), ..Execution::default() },
        1 => inside(ExecutionModel::ExecIn),
        2 => inside(ExecutionModel::ExecOut),
        3 => grid(),
        _ => own_thread(),
    }
}

fn grid() -> Execution {
    Execution { model: Some(ExecutionModel::Periodic), period_ns: Some(1_000_000), ..Execution::default() }
}

fn change(rng: &mut Rng) -> Op {
    let client = CLIENTS[rng.usize(0..2)];
    // Mostly the pair that was wired at the beginning, so that much is there to be cut and replaced.
    let own = SERVERS[CLIENTS.iter().position(|c| *c == client).unwrap_or(0)];
    let server = if rng.u8(0..4) == 0 { SERVERS[rng.usize(0..2)] } else { own };
    // Mostly servers: a client that stands still makes no calls.
    let any = if rng.u8(0..4) == 0 { client } else { server };
    let ports = match rng.u8(0..5) {
        0 => (format!("{client}/fifo"), format!("{server}/value_out")),
        1 => (format!("{client}/frame"), format!("{server}/frame_out")),
        _ => (format!("{client}/peer"), format!("{server}/ctl")),
    };
    match rng.u8(0..20) {
        0 => Op::Remove(any),
        1 | 2 => {
            let execution = if any == client { self::client(rng) } else { self::server(rng) };
            Op::Create(any, Box::new(execution))
        }
        3 | 4 => Op::Stop(any),
        5..=8 => Op::Start(any),
        9 | 10 => Op::Resume(any),
        11 | 12 => Op::Reset(any),
        13 => Op::Configure(server, f64::from(rng.u8(0..10))),
        14 | 15 => Op::Disconnect(ports.0, ports.1),
        n => Op::Connect(ports.0, ports.1, n % 2 == 0),
    }
}

fn call(rng: &mut Rng) -> Call {
    const WHAT: [Function; 11] = [
        Function::Poke,
        Function::Write,
        Function::WriteLatest,
        Function::WriteNewest,
        Function::Take,
        Function::Twice,
        Function::Value,
        Function::Scaled,
        Function::Burst,
        Function::Publish,
        Function::PublishFrames,
    ];
    // Rarely a panic, so that most worlds live on.
    let what = if rng.u8(0..40) == 0 { Function::Crash } else { WHAT[rng.usize(0..WHAT.len())] };
    let arg = f64::from(rng.u8(0..12));
    let threads = u32::from(rng.u8(0..3));
    if rng.bool() {
        Call::send(what, arg).from_threads(threads).times(u32::from(rng.u8(1..20)))
    } else {
        Call::call(what, arg).from_threads(threads).times(u32::from(rng.u8(1..3))).within_ms(5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_always_draws_the_same() {
        let told = |s: Script| format!("{} {:?}", s.told(), s.calls);
        assert_eq!(told(draw(7)), told(draw(7)));
        assert_ne!(told(draw(7)), told(draw(8)));
    }
}
