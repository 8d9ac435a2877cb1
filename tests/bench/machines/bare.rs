//! Samples over TCP without trocar, between two processes: a write and a read, nothing encrypted.
//!
//! Invariant: the other end is this program again, told so by its first argument; it ends when it has taken
//! all.

use std::hint::black_box;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};

use crate::baseline::{exact_timers, now_ns, sleep_until};

/// First argument of the other end.
pub(crate) const OTHER_END: &str = "--bare-tcp";

/// Samples before those that count.
const WARM: usize = 20;

/// p50 and p99 of the way of so many bytes, ns, sent each `period_ns` to a process that sleeps: until the
/// last of them is there.
pub(crate) fn one_way(bytes: usize, count: usize, period_ns: u64) -> (f64, f64) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("it has an address").port();
    let mut child = other_end(port, bytes, count);
    let (mut stream, _) = listener.accept().expect("the other end calls");
    stream.set_nodelay(true).expect("a TCP connection");
    let sender = std::thread::spawn(move || {
        exact_timers();
        let mut sample = vec![1u8; bytes.max(8)];
        let mut due = now_ns();
        for _ in 0..WARM + count {
            due += period_ns;
            sleep_until(due);
            sample[..8].copy_from_slice(&now_ns().to_le_bytes());
            stream.write_all(&sample).expect("the other end takes it");
        }
    });
    let mut lines = BufReader::new(child.stdout.take().expect("its output is a pipe")).lines();
    let line = lines.next().expect("the other end answers").expect("it can be read");
    sender.join().expect("the sending thread does not panic");
    child.wait().expect("the other end ends");
    let mut figures = line.split(' ').map(|n| n.parse().expect("a number"));
    (figures.next().expect("p50"), figures.next().expect("p99"))
}

fn other_end(port: u16, bytes: usize, count: usize) -> Child {
    let me = std::env::current_exe().expect("this program has a path");
    let numbers = [usize::from(port), bytes, count].map(|number| number.to_string());
    let mut command = Command::new(me);
    command.arg(OTHER_END).args(numbers).stdin(Stdio::null()).stdout(Stdio::piped());
    command.spawn().expect("this program starts again")
}

/// `--bare-tcp PORT BYTES COUNT`: takes samples and says how long they took.
pub(crate) fn run_other_end(args: &[String]) {
    let number = |at: usize| args[at].parse::<usize>().expect("a number");
    let (port, bytes, count) = (number(0) as u16, number(1).max(8), number(2));
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the first end listens");
    let mut sample = vec![0; bytes];
    let mut ways = Vec::with_capacity(WARM + count);
    while ways.len() < WARM + count {
        stream.read_exact(&mut sample).expect("the first end sends");
        let sent = u64::from_le_bytes(*sample.first_chunk().expect("eight bytes"));
        ways.push(now_ns().saturating_sub(sent));
        black_box(&sample);
    }
    let ways = &mut ways[WARM..];
    ways.sort_unstable();
    println!("{} {}", ways[ways.len() / 2], ways[ways.len() * 99 / 100]);
}
