//! `peer-iceoryx2 BYTES COUNT`: one-way times of iceoryx2's event path between two processes; prints p50 and
//! p99 in ns.
//!
//! Invariant: as the benchmark does it with trocar: one sample each 250 µs, its time of sending in it, the
//! reader asleep until it is told; up to 64 KiB the bytes are written for each sample, larger ones are handed
//! on as they are.

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};

use iceoryx2::prelude::*;

/// Between two samples, ns.
const PERIOD_NS: u64 = 250_000;
/// Larger samples are not written anew each time, B.
const WRITTEN: usize = 1 << 16;
/// Samples before those that count.
const WARM: usize = 200;
/// Time of a sample that says that no further one comes.
const END: u64 = 0;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize| -> Result<usize, Box<dyn Error>> {
        Ok(args.get(at).ok_or("peer-iceoryx2 BYTES COUNT")?.parse()?)
    };
    let (bytes, count) = (number(0)?, number(1)?);
    if bytes < 8 {
        return Err("a sample has its time in it: at least 8 B".into());
    }
    match args.get(2) {
        None => send(bytes, count),
        Some(name) => take(name, count),
    }
}

fn send(bytes: usize, count: usize) -> Result<(), Box<dyn Error>> {
    let name = format!("trocar-bench/{}", std::process::id());
    let node = NodeBuilder::new().create::<ipc::Service>()?;
    let samples = node.service_builder(&name.as_str().try_into()?).publish_subscribe::<[u8]>().create()?;
    let events = node.service_builder(&name.as_str().try_into()?).event().create()?;
    let publisher = samples.publisher_builder().initial_max_slice_len(bytes).create()?;
    let notifier = events.notifier_builder().create()?;
    let mut reader = Command::new(std::env::current_exe()?)
        .args([bytes.to_string(), count.to_string(), name])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut said = BufReader::new(reader.stdout.take().ok_or("no output of the reader")?).lines();
    if said.next().transpose()?.as_deref() != Some("ready") {
        return Err("the reader did not become ready".into());
    }
    let content = vec![1u8; bytes.min(WRITTEN)];
    // SAFETY: concerns this thread alone.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
    let mut due = now_ns();
    for i in 0..WARM + count + 1 {
        due += PERIOD_NS;
        sleep_until(due);
        // The newest sample is never overwritten: the end is what gets there in any case.
        let when = if i < WARM + count { now_ns() } else { END };
        let sample = publisher.loan_slice_uninit(bytes)?;
        // SAFETY: bytes of whatever value are bytes; the memory is there, it comes from a file that was
        // filled with zeros.
        let mut sample = unsafe { sample.assume_init() };
        if bytes <= WRITTEN {
            sample.payload_mut().copy_from_slice(&content);
        }
        sample.payload_mut()[..8].copy_from_slice(&when.to_ne_bytes());
        sample.send()?;
        notifier.notify()?;
    }
    let line = said.next().transpose()?.ok_or("the reader ended without a word")?;
    reader.wait()?;
    println!("{line}");
    Ok(())
}

fn take(name: &str, count: usize) -> Result<(), Box<dyn Error>> {
    let node = NodeBuilder::new().create::<ipc::Service>()?;
    let samples = node.service_builder(&name.try_into()?).publish_subscribe::<[u8]>().open()?;
    let events = node.service_builder(&name.try_into()?).event().open()?;
    let subscriber = samples.subscriber_builder().create()?;
    let listener = events.listener_builder().create()?;
    println!("ready");
    std::io::stdout().flush()?;
    let mut ways = Vec::with_capacity(WARM + count);
    let mut over = false;
    while !over {
        listener.blocking_wait(|_| {})?;
        while let Some(sample) = subscriber.receive()? {
            let bytes = sample.payload();
            let when = u64::from_ne_bytes(bytes[..8].try_into()?);
            std::hint::black_box(bytes[bytes.len() - 1]);
            match when {
                END => over = true,
                when => ways.push(now_ns().saturating_sub(when)),
            }
        }
    }
    if ways.len() < WARM + count / 2 {
        return Err(format!("only {} of {} samples came", ways.len(), WARM + count).into());
    }
    let mut ways = ways.split_off(WARM);
    ways.sort_unstable();
    println!("{} {}", ways[ways.len() / 2], ways[ways.len() * 99 / 100]);
    Ok(())
}

fn sleep_until(due: u64) {
    let until =
        libc::timespec { tv_sec: (due / 1_000_000_000) as i64, tv_nsec: (due % 1_000_000_000) as i64 };
    // SAFETY: the time lives for the call; nobody asks for the rest.
    unsafe {
        libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &until, std::ptr::null_mut())
    };
}

/// The monotonic clock.
fn now_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: room for one time.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
