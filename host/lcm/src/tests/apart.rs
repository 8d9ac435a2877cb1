//! Reads of a component in another process, from inside a step: those of every component, and those of a
//! class whose code is in both processes or only in that of the component.
//!
//! Promise: where the code is present, reads are answered at once and as inside one process; elsewhere a step
//! is told that it would wait.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_lcm_api::{ClassOf, RemoteEnd};
use trocar_plugin_api::abi::{EXECUTED, FAILED, Outcome, PEER_LOST, Tick, UNBOUND, WOULD_BLOCK};
use trocar_rt::os;

use super::super::boundary::counting;
use super::super::boundary::puppet::{KnownClasses, Own, on_read};
use super::*;

/// Two processes, a server in one and a client of it in the other.
struct Pair {
    left: World,
    right: World,
    _dir: tempfile::TempDir,
}

impl Pair {
    /// A pair whose client's process has those classes.
    fn of(names: [&'static str; 2], classes: Arc<dyn Classes>) -> Pair {
        let dir = tempfile::tempdir().unwrap();
        let socket = |name: &str| Some(dir.path().join(name));
        let left = World::with(names[0], classes, socket("left.sock"));
        let right = World::with(names[1], Arc::new(PuppetClasses), socket("right.sock"));
        Pair { left, right, _dir: dir }
    }

    /// Connects `client/peer` to this interface of the server, as a GCM does.
    async fn connect(&self, client: &ClassInfo, server: &ClassInfo, interface: &str) {
        let port = |world: &World, path: &str| PortId::parse(&format!("{}/{path}", world.process)).unwrap();
        let connection = Connection {
            id: ConnectionId(1),
            client: port(&self.left, "client/peer"),
            server: port(&self.right, &format!("server/{interface}")),
            options: ConnectOptions::default(),
        };
        let ends = [(&self.right, client, &self.left), (&self.left, server, &self.right)];
        for (at, class, other) in ends {
            let end = RemoteEnd {
                connection: connection.clone(),
                ports: Arc::new(class.ports.clone()),
                class: ClassOf { name: class.full_name(), hash: class.hash.clone() },
                card: other.lcm.inventory().await.unwrap().card.unwrap(),
            };
            at.lcm.link(end, Instant::now() + PATIENCE).await.unwrap();
        }
        self.left.start("client").await;
    }

    async fn end(self) {
        self.left.end().await;
        self.right.end().await;
    }
}

/// Counts its steps.
#[derive(Default)]
struct Steps(AtomicU64);

impl Behaviour for Steps {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.0.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

/// Looks at GetState and `period_statistics` in each step.
#[derive(Default)]
struct Looks {
    /// Cycles of the server at the last look.
    executed: AtomicU64,
    active: AtomicU64,
}

fn word(row: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(row[8 * at..8 * at + 8].try_into().unwrap())
}

/// Words in front of `executed` in a `PeriodStatistics`.
const EXECUTED_AT: usize = 13;

impl Behaviour for Looks {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        let before_ns = os::now_ns();
        let (outcome, row) = own.ask(0);
        let after_ns = os::now_ns();
        // A busy machine may take the other process for lost, for a while.
        if [PEER_LOST, UNBOUND].contains(&outcome) {
            return Ok(());
        }
        if outcome != EXECUTED || !(before_ns..=after_ns).contains(&word(&row, 0)) {
            return Err(format!("GetState came to {outcome} with a stamp that is not of now"));
        }
        let (outcome, figures) = own.ask(1);
        // No statistics exist before the first look of the watchdog.
        if outcome == EXECUTED {
            self.executed.store(word(&figures, EXECUTED_AT), Ordering::SeqCst);
        }
        self.active.store(u64::from(row.windows(6).any(|w| w == b"ACTIVE")), Ordering::SeqCst);
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_every_component_shows_is_of_now_in_a_step_of_another_process_too() {
    let pair = Pair::of(["ap_looks", "ap_shows"], Arc::new(PuppetClasses));
    let system = trocar_loader::system::interface();
    let functions: Vec<_> = system.commands.iter().map(|c| (c.name.as_str(), c.ret.clone())).collect();
    let (client, server) = (class(requires(&functions), Safety::None), class(Ports::default(), Safety::None));
    let (looks, steps) = (Arc::new(Looks::default()), Arc::new(Steps::default()));
    pair.right.create_as("server", server.clone(), periodic(1000), steps.clone()).await;
    pair.left.create_as("client", client.clone(), periodic(500), looks.clone()).await;
    pair.connect(&client, &server, "system").await;
    assert_eq!(looks.executed.load(Ordering::SeqCst), 0);
    pair.right.start("server").await;
    eventually("figures of a component without a state", || looks.executed.load(Ordering::SeqCst) > 20).await;
    eventually("it is seen to be ACTIVE", || looks.active.load(Ordering::SeqCst) == 1).await;
    pair.right.run("server", Verb::Stop).await.unwrap();
    let last = steps.0.load(Ordering::SeqCst);
    eventually("its last cycle", || looks.executed.load(Ordering::SeqCst) == last).await;
    eventually("it is seen to have stopped", || looks.active.load(Ordering::SeqCst) == 0).await;
    assert_eq!(pair.left.report("client").await.state, State::Active, "each look was as it should be");
    pair.end().await;
}

fn number() -> Type {
    Type::Prim(Prim::U64)
}

/// A server with the read `one` from u64 to u64, and a client of it.
fn classes() -> (ClassInfo, ClassInfo) {
    let mut served = ctl();
    served.state = Some(number());
    let arg = trocar_model::Arg {
        name: String::new(),
        doc: String::new(),
        ty: number(),
        unit: String::new(),
        min: None,
        max: None,
    };
    served.provided[0].commands[0] = Command {
        name: "one".into(),
        kind: CommandKind::QualifiedRead,
        arg: Some(arg),
        ret: Some(number()),
        ..served.provided[0].commands[0].clone()
    };
    let mut required = requires(&[("one", Some(number()))]);
    required.required[0].functions[0].arg = Some(number());
    (class(required, Safety::None), class(served, Safety::None))
}

/// Reads in each step; keeps the last result, and its allocations.
struct Reads {
    arg: u64,
    answer: Mutex<Option<(Outcome, u64)>>,
    allocated: AtomicU64,
    times: AtomicU64,
}

impl Reads {
    fn with(arg: u64) -> Arc<Reads> {
        Arc::new(Reads {
            arg,
            answer: Mutex::default(),
            allocated: AtomicU64::new(0),
            times: AtomicU64::new(0),
        })
    }

    fn last(&self) -> Option<(Outcome, u64)> {
        *self.answer.lock().unwrap()
    }
}

impl Behaviour for Reads {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        counting::watch();
        let answer = own.read(0, self.arg);
        self.allocated.fetch_add(counting::watched(), Ordering::SeqCst);
        *self.answer.lock().unwrap() = Some(answer);
        self.times.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

/// Starts a client that reads with `arg` at each of its steps.
async fn reading(names: [&'static str; 2], arg: u64, present: bool) -> (Pair, Arc<Reads>) {
    let (client, server) = classes();
    let classes: Arc<dyn Classes> =
        if present { Arc::new(KnownClasses(Arc::new(server.clone()))) } else { Arc::new(PuppetClasses) };
    let (pair, reads) = (Pair::of(names, classes), Reads::with(arg));
    pair.right.create_as("server", server.clone(), periodic(1000), Arc::new(Steps::default())).await;
    pair.left.create_as("client", client.clone(), periodic(1000), reads.clone()).await;
    pair.right.start("server").await;
    pair.connect(&client, &server, "ctl").await;
    (pair, reads)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_reads_a_component_of_another_process_whose_class_is_in_its_own() {
    let arg = 41_001;
    let asked = Arc::new(AtomicU64::new(0));
    let count = asked.clone();
    on_read(arg, move || {
        count.fetch_add(1, Ordering::SeqCst);
        7
    });
    let (pair, reads) = reading(["ap_has", "ap_gives"], arg, true).await;
    eventually("a step has read", || reads.last() == Some((EXECUTED, 7))).await;
    eventually("it reads on", || reads.times.load(Ordering::SeqCst) > 100).await;
    assert_eq!(reads.allocated.load(Ordering::SeqCst), 0, "a read in a step allocated");
    // A server that is stopped is read as before.
    pair.right.run("server", Verb::Stop).await.unwrap();
    let so_far = asked.load(Ordering::SeqCst);
    eventually("it is read on", || asked.load(Ordering::SeqCst) > so_far + 10).await;
    assert_eq!(reads.last(), Some((EXECUTED, 7)));
    pair.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_would_have_to_ask_another_process_is_told_so() {
    let arg = 41_002;
    on_read(arg, || 8);
    let (pair, reads) = reading(["ap_lacks", "ap_keeps"], arg, false).await;
    eventually("a step has tried", || reads.last() == Some((WOULD_BLOCK, 0))).await;
    let refused = |r: &Report| r.warnings.iter().any(|w| w.contains("its step called commands of another"));
    pair.left.eventually("a word about it", "client", refused).await;
    pair.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_read_that_panics_in_the_client_s_process_is_told_of_its_server() {
    let arg = 41_003;
    on_read(arg, || panic!("out of its depth"));
    let (pair, reads) = reading(["ap_panics", "ap_hears"], arg, true).await;
    eventually("a step has read", || reads.last() == Some((FAILED, 0))).await;
    let said = |r: &Report| {
        let words = |w: &String| w.starts_with("its reads panicked") && w.contains("(in process ap_panics)");
        r.warnings.iter().any(words)
    };
    let report = pair.right.eventually("a word about it", "server", said).await;
    assert_eq!(report.state, State::Active, "no instance was entered");
    pair.end().await;
}
