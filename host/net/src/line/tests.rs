#![allow(clippy::unwrap_used)]

use std::io::Write;
use std::net::TcpStream;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use tempfile::TempDir;

use super::greeting::Met;
use super::wire::Inbox;
use super::*;
use crate::tests::wish;
use crate::{Authority, Identity, Revoked, Role, Wish};

/// For what comes in any case: a watchdog, not a claim.
const PATIENCE: Duration = Duration::from_secs(30);

/// Messages that wait for the bulk lane.
type Long = Arc<Mutex<Vec<(u8, Vec<u8>)>>>;

/// News that a process hears of its lines.
enum News {
    Met(Arc<Line>),
    Came(u8, Vec<u8>),
    Lost(String),
}

struct Ear {
    tell: Mutex<Sender<News>>,
    /// Whoever listens stands still at a message of kind 14 until this is let go.
    gate: Arc<Mutex<()>>,
    /// Messages for the bulk lane.
    long: Long,
}

impl Ear {
    fn tell(&self, news: News) {
        // The test may be over.
        let _ = self.tell.lock().send(news);
    }
}

impl Handler for Arc<Ear> {
    fn met(&self, line: &Arc<Line>) -> Arc<dyn Traffic> {
        self.tell(News::Met(line.clone()));
        self.clone()
    }

    fn lost(&self, _: &Arc<Line>, why: &str) {
        self.tell(News::Lost(why.into()));
    }
}

impl Traffic for Ear {
    fn came(&self, _: Lane, kind: u8, content: &[u8]) -> Result<(), String> {
        if kind == 13 {
            return Err("thirteen".into());
        }
        if kind == 14 {
            drop(self.gate.lock());
        }
        self.tell(News::Came(kind, content.to_vec()));
        Ok(())
    }

    fn fill(&self, lane: Lane, out: &mut Outbox) -> bool {
        if lane == Lane::Bulk {
            let long = std::mem::take(&mut *self.long.lock());
            long.iter().for_each(|(kind, bytes)| out.message(*kind, |to| to.extend_from_slice(bytes)));
        }
        false
    }
}

struct Lab {
    dir: TempDir,
    authority: Authority,
}

struct Process {
    lines: Lines,
    news: Receiver<News>,
    place: Place,
    gate: Arc<Mutex<()>>,
    long: Long,
}

impl Process {
    fn hear(&self) -> News {
        self.news.recv_timeout(PATIENCE).expect("something is heard")
    }

    fn meets(&self) -> Arc<Line> {
        match self.hear() {
            News::Met(line) => line,
            News::Came(..) => panic!("something came"),
            News::Lost(why) => panic!("lost: {why}"),
        }
    }

    fn loses(&self) -> String {
        loop {
            if let News::Lost(why) = self.hear() {
                return why;
            }
        }
    }

    /// Reason why there is no line, once one is known.
    fn in_vain(&self, place: &Place) -> String {
        let until = std::time::Instant::now() + PATIENCE;
        loop {
            if let Some(why) = self.lines.why_not(place) {
                return why;
            }
            assert!(std::time::Instant::now() < until, "nothing is known");
            std::thread::yield_now();
        }
    }
}

impl Lab {
    fn new() -> Lab {
        let dir = tempfile::tempdir().unwrap();
        let authority = Authority::init(&dir.path().join("authority")).unwrap();
        Lab { dir, authority }
    }

    fn identity(&mut self, name: &str) -> Arc<Identity> {
        let out = self.dir.path().join(name);
        let wish = Wish { processes: vec![name.into()], ..wish(name, Role::Host) };
        self.authority.issue(&wish, &out).unwrap();
        Arc::new(Identity::read(&out).unwrap())
    }

    fn process(&mut self, name: &str) -> Process {
        let identity = self.identity(name);
        let revoked = Arc::new(Revoked::read(&self.authority.revoked_list()).unwrap());
        start(name, identity, revoked)
    }
}

fn start(name: &str, identity: Arc<Identity>, revoked: Arc<Revoked>) -> Process {
    let (tell, news) = channel();
    let who = Who { process: name.into(), instance: format!("{name}-1") };
    let ends = Ends { who: who.clone(), identity, revoked: Some(revoked), most_rate: None };
    let gate = Arc::new(Mutex::new(()));
    let long = Arc::default();
    let ear = Ear { tell: Mutex::new(tell), gate: gate.clone(), long: Arc::clone(&long) };
    let lines = Lines::start(([127, 0, 0, 1], 0).into(), ends, Arc::new(ear)).unwrap();
    let address = format!("127.0.0.1:{}", lines.port());
    let place = Place { process: who.process, instance: who.instance, address };
    Process { lines, news, place, gate, long }
}

#[test]
fn two_processes_meet_and_what_one_says_the_other_hears_in_order() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    let (of_left, of_right) = (left.meets(), right.meets());
    assert_eq!((of_left.who().process.as_str(), of_right.who().process.as_str()), ("right", "left"));
    assert!(of_left.clock().offset_ns().unsigned_abs() <= of_left.clock().bound_ns(), "it is one clock");
    for (n, size) in [(1, 0), (2, 10), (3, 1 << 20), (4, 70_000)] {
        of_left.say(n, vec![n; size]).unwrap();
        of_right.say(n, vec![n; size]).unwrap();
    }
    for process in [&left, &right] {
        for (n, size) in [(1, 0), (2, 10), (3, 1 << 20), (4, 70_000)] {
            match process.hear() {
                News::Came(kind, content) => assert_eq!((kind, content.len()), (n, size)),
                _ => panic!("no message"),
            }
        }
    }
    left.lines.leave(&right.place);
    assert!(left.loses().contains("from here") && right.loses().contains("it ended"));
    assert!(of_left.is_lost() && of_left.say(1, Vec::new()) == Err(Unsaid::Lost));
}

#[test]
fn what_is_long_holds_up_nothing_that_is_short() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    let line = left.meets();
    right.meets();
    let shut = right.gate.lock();
    left.long.lock().extend([(14, vec![0; 8 << 20]), (15, Vec::new())]);
    line.bell(Lane::Bulk).notify();
    line.say(1, Vec::new()).unwrap();
    assert!(matches!(right.hear(), News::Came(1, _)), "it comes while the long one waits");
    drop(shut);
    let heard = || match right.hear() {
        News::Came(kind, content) => (kind, content.len()),
        _ => panic!("no message"),
    };
    assert_eq!([heard(), heard()], [(14, 8 << 20), (15, 0)]);
}

/// Policies by which the kernel schedules the threads of this name.
fn policies(name: &str) -> Vec<String> {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().flatten();
    let stats = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("stat")).ok());
    let named = stats.filter_map(|stat| {
        let (before, after) = stat.rsplit_once(") ")?;
        (before.split_once('(')?.1 == name).then(|| after.split(' ').nth(38).map(str::to_owned))?
    });
    named.collect()
}

#[test]
fn the_threads_that_callers_wait_for_are_real_time_ones_where_the_machine_allows_it() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    left.meets();
    let is_allowed = std::thread::spawn(|| trocar_rt::os::set_fifo(30).is_ok()).join().unwrap();
    let real_time = if is_allowed { "1" } else { "0" };
    let expected = [
        ("trocar-line", real_time),
        ("trocar-line-out", real_time),
        ("trocar-bulk", "0"),
        ("trocar-dial", "0"),
    ];
    let until = std::time::Instant::now() + PATIENCE;
    // Lines of other tests are just being made.
    loop {
        let seen = expected.map(|(name, _)| policies(name));
        let are_so = |(seen, (_, policy)): (&Vec<String>, &(&str, &str))| {
            !seen.is_empty() && seen.iter().all(|one| one == policy)
        };
        if seen.iter().zip(&expected).all(are_so) {
            return;
        }
        assert!(std::time::Instant::now() < until, "{expected:?}, and these are: {seen:?}");
        std::thread::yield_now();
    }
}

/// A connection with a process, before anything was said on it.
fn dialled(to: &Process, identity: Arc<Identity>) -> (rustls::ClientConnection, TcpStream) {
    let client = crate::Client::of_processes(identity, None, &["trocar-line"]).unwrap();
    let name = rustls::pki_types::ServerName::try_from("trocar").unwrap();
    let tls = rustls::ClientConnection::new(client.config(), name).unwrap();
    (tls, TcpStream::connect(&to.place.address).unwrap())
}

#[test]
fn a_second_connection_that_belongs_to_no_line_of_its_process_is_refused() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    left.meets();
    // The line that there is, and it has both; and one that there is not.
    let (identity, number) = (lab.identity("third"), right.meets().number());
    for line in [number, 77] {
        let (tls, stream) = dialled(&right, identity.clone());
        let until = std::time::Instant::now() + PATIENCE;
        let (mut wire, holder, inbox) = Wire::greeted(stream, tls.into(), until).unwrap();
        let own = Who { process: "third".into(), instance: "third-1".into() };
        let met = Met { who: own.clone(), line, clock: Clock::default(), inbox: Inbox::default() };
        let refused = greeting::call_beside((&mut wire, inbox), &holder, &own, (&met, until));
        let why = refused.err().map(|refused| refused.why).unwrap_or_default();
        assert!(why.contains("no line here that waits"), "{line}: {why}");
    }
}

#[test]
fn a_line_that_is_lost_comes_again_and_is_another_one() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    let first = left.meets();
    right.meets().end("the test ends it");
    assert!(left.loses().contains("it ended"));
    let second = left.meets();
    assert!(first.is_lost() && !second.is_lost() && first.number() != second.number());
}

#[test]
fn a_process_that_its_certificate_does_not_name_is_met_by_nobody() {
    let mut lab = Lab::new();
    let right = lab.process("right");
    let revoked = Arc::new(Revoked::read(&lab.authority.revoked_list()).unwrap());
    // It is found out by the one it calls, and by the one that calls it.
    let identity = lab.identity("third");
    let liar = start("left", identity, revoked);
    liar.lines.want(&right.place);
    let why = liar.in_vain(&right.place);
    assert!(why.contains("it says that it is process left") && why.contains("host third"), "{why}");
    right.lines.want(&liar.place);
    let why = right.in_vain(&liar.place);
    assert!(why.contains("it says that it is process left"), "{why}");
    // Another process at the place of the one that was meant.
    let other = Place { process: "left".into(), ..right.place.clone() };
    let third = lab.process("fourth");
    third.lines.want(&other);
    let why = third.in_vain(&other);
    assert!(why.contains("right answers at"), "{why}");
}

#[test]
fn one_of_another_authority_and_one_that_shows_nothing_learn_nothing() {
    let (mut lab, mut elsewhere) = (Lab::new(), Lab::new());
    let (left, right) = (elsewhere.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    let why = left.in_vain(&right.place);
    assert!(why.contains("of another authority"), "{why}");
    let mut stream = TcpStream::connect(&right.place.address).unwrap();
    stream.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    let mut said = Vec::new();
    // A reset is as good an end as any.
    let _ = std::io::Read::read_to_end(&mut stream, &mut said);
    assert!(said.len() < 10, "no more than an alert: {said:?}");
}

#[test]
fn a_certificate_that_is_taken_back_ends_the_line_and_opens_no_other() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    left.meets();
    right.meets();
    lab.authority.revoke("left").unwrap();
    assert!(right.loses().contains("revoked"));
    left.loses();
    let until = std::time::Instant::now() + PATIENCE;
    while left.lines.why_not(&right.place).is_none_or(|why| !why.contains("revoked")) {
        assert!(std::time::Instant::now() < until, "{:?}", left.lines.why_not(&right.place));
        std::thread::yield_now();
    }
}

#[test]
fn whoever_says_what_it_may_not_is_listened_to_no_more() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    left.meets().say(13, Vec::new()).unwrap();
    assert!(right.loses().contains("what it may not: thirteen"));
}

#[test]
fn a_process_that_is_not_there_is_called_until_it_is() {
    let mut lab = Lab::new();
    let left = lab.process("left");
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = free.local_addr().unwrap().to_string();
    drop(free);
    let nobody = Place { process: "right".into(), instance: "right-1".into(), address };
    left.lines.want(&nobody);
    assert!(left.in_vain(&nobody).contains("refused"), "{}", left.in_vain(&nobody));
    assert!(left.lines.refused(&nobody).is_none(), "to wait may help");
    left.lines.stop();
    assert!(left.lines.line(&nobody).is_none());
}

#[test]
fn whoever_takes_leave_and_goes_on_is_read_no_more() {
    let mut lab = Lab::new();
    let right = lab.process("right");
    let (mut tls, mut stream) = dialled(&right, lab.identity("left"));
    while tls.is_handshaking() {
        tls.complete_io(&mut stream).unwrap();
    }
    tls.send_close_notify();
    while tls.wants_write() {
        tls.write_tls(&mut stream).unwrap();
    }
    // The other end may have gone already.
    let _ = stream.write_all(&[0; 1000]);
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let ended = std::io::Read::read_to_end(&mut stream, &mut Vec::new());
    let waited = ended.is_err_and(|e| e.kind() == std::io::ErrorKind::WouldBlock);
    assert!(!waited, "the connection is not ended");
}

#[test]
fn a_process_that_calls_anew_has_its_newest_line_alone() {
    let mut lab = Lab::new();
    let (right, left) = (lab.process("right"), lab.process("left"));
    left.lines.want(&right.place);
    let first = right.meets();
    let again = lab.process("left");
    again.lines.want(&right.place);
    assert!(right.loses().contains("called anew"));
    assert!(first.is_lost());
}

#[test]
fn a_line_whose_other_end_takes_nothing_is_lost() {
    let mut lab = Lab::new();
    let (left, right) = (lab.process("left"), lab.process("right"));
    left.lines.want(&right.place);
    left.meets();
    let line = right.meets();
    let shut = left.gate.lock();
    line.say(14, Vec::new()).unwrap();
    // As much as the machine keeps, and more.
    while line.say(15, vec![0; 1 << 20]) != Err(Unsaid::Lost) {
        std::thread::yield_now();
    }
    assert!(right.loses().contains("takes nothing"));
    drop(shut);
}
