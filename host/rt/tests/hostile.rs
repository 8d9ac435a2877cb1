//! A process at the other end that is hostile: words that change under every look, frames that never come
//! back, bells that lie, and a machine that has nothing to give.
#![allow(clippy::unwrap_used)]

mod parts;

use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;

use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::now_ns;
use trocar_rt::pool::{FramePool, PoolFile};
use trocar_rt::region::{Layout, Region};
use trocar_rt::segment::{Agreed, CallShape, RemoteCalls, ServedCalls};
use trocar_rt::stream::{
    Meta, Payload, Pushed, Queue, RemotePools, RemoteViews, StreamReader, StreamWriter, remote_reader,
    remote_writer,
};
use trocar_rt::wake::{Waker, wait_any};

use parts::{QUEUES, reading, writing};

fn again(region: &Region, bytes: usize) -> Arc<Region> {
    Region::open(region.fd().unwrap().try_clone_to_owned().unwrap(), bytes).unwrap()
}

fn meta(seq: u64) -> Meta {
    Meta { stamp_ns: seq, came_ns: 0, seq }
}

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

/// Writes anything anywhere in the block until it is told to stop.
fn play(words: &[AtomicU64], over: &AtomicBool, seed: u64) {
    let mut random = Random(seed | 1);
    while !over.load(Ordering::Relaxed) {
        let word = &words[random.next() as usize % words.len()];
        let was = word.load(Ordering::Relaxed);
        let value = match random.next() % 5 {
            0 => random.next(),
            1 => random.next() % 8,
            2 => u64::MAX - random.next() % 8,
            3 => was ^ (1 << (random.next() % 64)),
            _ => was.wrapping_add(random.next() % 9).wrapping_sub(4),
        };
        word.store(value, Ordering::Relaxed);
    }
}

fn tell(pool: &Arc<FramePool>, pools: &RemotePools, views: &RemoteViews) {
    let file = pool.file().unwrap();
    let theirs = PoolFile::open(file.fd().try_clone_to_owned().unwrap(), file.shape()).unwrap();
    assert!(views.know(0, theirs));
    assert_eq!(pools.place_of(file.number()), Some(0));
}

/// The two ends and a third hand that writes all the time: every call comes back, and a sample in sight stays
/// as it is.
#[test]
fn words_that_change_under_every_look_crash_and_hang_nobody() {
    for (round, queue) in QUEUES.into_iter().cycle().take(9).enumerate() {
        let pool = FramePool::new(8, 64, 64).unwrap();
        let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(64));
        tell(&pool, &pools, &views);
        let lay = |layout: &mut Layout| writing(layout, queue, &pools);
        let lay_other = |layout: &mut Layout| reading(layout, queue, &views);
        let bytes = Layout::measure(lay);
        let here = Region::shared(bytes).unwrap();
        let (mail, replies, bell, plain, frames) = lay(&mut Layout::fresh(&here));
        let there = again(&here, bytes);
        let (theirs, answers, rung, mut plain_in, mut frames_in) =
            lay_other(&mut Layout::of_other_end(&there));
        let hostile = again(&here, bytes);
        let words = Layout::words(&hostile, bytes / 8);
        // The words of the pool, too: its maker may write it while it is read.
        let file = pool.file().unwrap();
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| play(&words, &over, round as u64 + 1));
            let client = scope.spawn(|| {
                for n in 0..4000u64 {
                    let ticket = replies.acquire();
                    let reply = ticket.as_ref().map_or(0, |t| t.token());
                    let head = EntryHead { index: n as u32 % 2, reply, ..EntryHead::default() };
                    let overflow =
                        [Overflow::Reject, Overflow::LatestWins, Overflow::DropOldest][n as usize % 3];
                    let _ = mail.push(head, &[1; 24], overflow);
                    bell.notify();
                    let _ = plain.push(&[n as u8; 24], meta(n));
                    if let Some(mut writing) = pool.loan() {
                        writing.parts_mut().0.fill(n as u8);
                        let _ = frames.push_frame(writing.freeze(8), meta(n));
                    }
                    if let Some(ticket) = ticket {
                        ticket.wait(now_ns() + 20_000, |ret, text| {
                            assert!(ret.len() == 8 && text.len() <= 32);
                        });
                    }
                    if n % 50 == 0 {
                        replies.end_all(-1);
                    }
                    let (m, s) = (mail.stats(), frames.stats());
                    let sum = m.pushed + m.dropped + m.rejected + m.queued + m.high_water;
                    assert!(sum + s.pushed + s.taken + s.dropped < u64::MAX, "sums of counts fit");
                }
                over.store(true, Ordering::Relaxed);
            });
            let own = Waker::new();
            let rung = [Arc::new(rung)];
            while !over.load(Ordering::Relaxed) {
                wait_any(&own, &rung, Some(now_ns() + 20_000));
                rung[0].take_if_set();
                let answer = |head: EntryHead, payload: &[u8]| {
                    assert!(payload.len() <= 24);
                    let before = payload.to_vec();
                    if let Some(running) = answers.begin(head.reply, -1) {
                        running.finish(0, |_, _| 1);
                    }
                    assert_eq!(payload, before, "an argument changed under its command");
                };
                theirs.drain(answer, |_| {});
                theirs.throw_out(|_| {}, |_| {});
                for _ in 0..8 {
                    let Some(sample) = plain_in.next() else { break };
                    let (meta, data) = (sample.meta, sample.data.to_vec());
                    assert_eq!(data.len(), 24);
                    let now = plain_in.current().unwrap();
                    assert_eq!((now.meta, now.data), (meta, &data[..]), "a sample changed under a look");
                }
                for _ in 0..8 {
                    let Some(sample) = frames_in.latest() else { break };
                    let (meta, header) = (sample.meta, sample.data.to_vec());
                    assert!(header.len() == 64 && sample.bytes.len() <= 64);
                    let now = frames_in.current().unwrap();
                    assert_eq!((now.meta, now.data), (meta, &header[..]), "a header changed under a look");
                }
            }
            client.join().unwrap();
            theirs.close(|_| {});
        });
        assert!(pool.loan().is_some(), "a reader that plays with the words took every slot ({queue:?})");
        let raw = file.fd().as_raw_fd();
        drop((plain, frames, plain_in, frames_in));
        // Its process is given up: whatever its words said, nothing stays lent.
        drop(pools);
        assert_eq!(pool.stats().free, 8, "frames were lost ({queue:?}, file {raw})");
    }
}

/// An entry that says it is longer than its place is cut to that: nothing beyond is read or written over.
#[test]
fn an_entry_longer_than_its_place_is_cut_to_it() {
    const LENGTH: u64 = 24;
    let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(64));
    let lay = |layout: &mut Layout| writing(layout, QUEUES[0], &pools);
    let lay_other = |layout: &mut Layout| reading(layout, QUEUES[0], &views);
    let bytes = Layout::measure(lay);
    let here = Region::shared(bytes).unwrap();
    let (mail, ..) = lay(&mut Layout::fresh(&here));
    let there = again(&here, bytes);
    let (theirs, ..) = lay_other(&mut Layout::of_other_end(&there));
    let hostile = again(&here, bytes);
    let words = Layout::words(&hostile, bytes / 8);
    let lengths = || -> Vec<usize> {
        (0..words.len()).filter(|at| words[*at].load(Ordering::Relaxed) == LENGTH).collect()
    };
    // The smallest ones first: a place has room for those, so a length that is believed is seen before it
    // does harm.
    for said in [LENGTH + 1, LENGTH + 8, 1 << 16, 1 << 40, u64::MAX] {
        let before = lengths();
        assert_eq!(mail.push(EntryHead::default(), &[7; LENGTH as usize], Overflow::Reject), Push::Queued);
        let new: Vec<usize> = lengths().into_iter().filter(|at| !before.contains(at)).collect();
        assert_eq!(new.len(), 1, "the length of the entry lies in the block");
        words[new[0]].store(said, Ordering::Relaxed);
        let (mut given, answer) = (Vec::new(), |_: EntryHead, payload: &[u8]| payload.to_vec());
        theirs.drain(|head, payload| given.push(answer(head, payload)), |_| {});
        assert_eq!(given, [vec![7; LENGTH as usize]], "of an entry that says {said} bytes");
    }
}

fn frames_between(queue: Queue) -> (Arc<FramePool>, StreamWriter, StreamReader) {
    let pool = FramePool::new(12, 8, 64).unwrap();
    let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(8));
    tell(&pool, &pools, &views);
    let bytes = Layout::measure(|l| remote_writer(l, Payload::Frame, queue, &pools));
    let here = Region::shared(bytes).unwrap();
    let writer = remote_writer(&mut Layout::fresh(&here), Payload::Frame, queue, &pools);
    let reader =
        remote_reader(&mut Layout::of_other_end(&again(&here, bytes)), Payload::Frame, queue, &views);
    (pool, writer, reader)
}

/// A reader that takes frames and gives none back has its share of the pool, and the others have theirs.
#[test]
fn a_reader_that_gives_no_frame_back_leaves_the_pool_to_the_others() {
    for queue in QUEUES {
        let (pool, writer, mut reader) = frames_between(queue);
        let mut kept = Vec::new();
        for seq in 1..100 {
            let writing = pool.loan().expect("the producer always finds a slot");
            let _ = writer.push_frame(writing.freeze(8), meta(seq));
            while reader.next().is_some() {
                kept.push(reader.frame().unwrap().clone());
            }
        }
        reader.release();
        let stats = pool.stats();
        assert!(kept.len() >= 3, "a reader may keep some: {} ({queue:?})", kept.len());
        assert!(stats.free >= 4, "a third of the pool is left to others: {stats:?} ({queue:?})");
        let counts = writer.stats();
        assert_eq!(
            counts.taken + counts.dropped,
            counts.pushed,
            "what it did not get is counted: {counts:?}"
        );
        kept.clear();
        assert!(writer.push_frame(pool.loan().unwrap().freeze(8), meta(200)) != Pushed::DroppedNewest);
        assert_eq!(reader.next().unwrap().meta.seq, 200, "it gets frames again ({queue:?})");
    }
}

#[test]
fn a_server_that_answers_what_nobody_asked_is_no_answer() {
    let shape = CallShape {
        depth: 4,
        commands: 1,
        arg_bytes: 8,
        reply_cells: 2,
        ret_bytes: 8,
        text_bytes: 16,
        event_bytes: 8,
        reads: vec![8],
        own_reads: 1,
    };
    let agreed = Agreed { hash: 1, epoch: 2 };
    let server = ServedCalls::create(&shape, agreed).unwrap();
    let client =
        RemoteCalls::open(server.fd().unwrap().try_clone_to_owned().unwrap(), &shape, agreed).unwrap();
    let ticket = client.replies.acquire().unwrap();
    let token = ticket.token();
    for forged in [0, 1, u64::MAX, token ^ 1, token ^ (1 << 40), token.wrapping_add(1 << 36)] {
        assert!(server.replies.begin(forged, 0).is_none(), "{forged:#x} is no call");
    }
    server.replies.begin(token, 0).unwrap().finish(7, |ret, _| {
        ret.fill(9);
        usize::MAX
    });
    assert!(server.replies.begin(token, 0).is_none(), "answered once");
    let mut text_bytes = 0;
    ticket.wait(u64::MAX, |_, text| text_bytes = text.len());
    assert_eq!(text_bytes, 16, "a text is as long as its room at most");
}

/// Refuses the call of this number with this errno, by a filter on the calling thread alone.
fn without_the_call(number: i64, errno: i32) {
    let code = [
        // The number of the call.
        libc::sock_filter { code: 0x20, jt: 0, jf: 0, k: 0 },
        libc::sock_filter { code: 0x15, jt: 0, jf: 1, k: number as u32 },
        libc::sock_filter { code: 0x06, jt: 0, jf: 0, k: libc::SECCOMP_RET_ERRNO | errno as u32 },
        libc::sock_filter { code: 0x06, jt: 0, jf: 0, k: libc::SECCOMP_RET_ALLOW },
    ];
    let program = libc::sock_fprog { len: code.len() as u16, filter: code.as_ptr().cast_mut() };
    // SAFETY: flags only; then a program that outlives the call, for the calling thread alone.
    unsafe {
        assert_eq!(libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), 0);
        assert_eq!(libc::prctl(libc::PR_SET_SECCOMP, libc::SECCOMP_MODE_FILTER, &raw const program), 0);
    }
}

fn bells(n: usize) -> Vec<Arc<Waker>> {
    let bytes = Layout::measure(Waker::lay_out);
    let bell = || Arc::new(Waker::lay_out(&mut Layout::fresh(&Region::shared(bytes).unwrap())));
    (0..n).map(|_| bell()).collect()
}

#[test]
fn where_the_kernel_cannot_sleep_on_several_words_nothing_is_missed() {
    for errno in [libc::ENOSYS, libc::EPERM] {
        let (own, bells) = (Arc::new(Waker::new()), bells(3));
        let (mine, rung) = (Arc::clone(&own), bells.clone());
        let (tell, told) = std::sync::mpsc::channel();
        let sleeper = thread::spawn(move || {
            without_the_call(libc::SYS_futex_waitv, errno);
            let begin = now_ns();
            assert!(!wait_any(&mine, &rung, Some(begin + 300_000)), "nobody rang");
            assert!(now_ns() >= begin + 300_000, "it came back before its time");
            tell.send("ready").unwrap();
            for _ in 0..20 {
                while !rung[2].take() {
                    wait_any(&mine, &rung, None);
                }
                tell.send("rung").unwrap();
                while !wait_any(&mine, &[], None) {}
                tell.send("woken").unwrap();
            }
            // With bells beside it, its own waker counts as ever.
            assert!(wait_any(&mine, &rung, None));
            tell.send("end").unwrap();
        });
        assert_eq!(told.recv().unwrap(), "ready");
        for _ in 0..20 {
            bells[2].notify();
            assert_eq!(told.recv().unwrap(), "rung");
            own.notify();
            assert_eq!(told.recv().unwrap(), "woken");
        }
        own.notify();
        assert_eq!(told.recv().unwrap(), "end");
        sleeper.join().unwrap();
    }
}

/// A bell with any word in it: the sleeper's own wakes and its deadlines count all the same.
#[test]
fn a_bell_that_lies_keeps_no_sleeper() {
    let bytes = Layout::measure(Waker::lay_out);
    let region = Region::shared(bytes).unwrap();
    let bell = [Arc::new(Waker::lay_out(&mut Layout::fresh(&region)))];
    let hostile = again(&region, bytes);
    let words = Layout::words(&hostile, bytes / 8);
    let (own, over) = (Waker::new(), AtomicBool::new(false));
    thread::scope(|scope| {
        scope.spawn(|| play(&words[..1], &over, 77));
        for n in 0..200 {
            if n % 2 == 0 {
                own.notify();
                assert!(wait_any(&own, &bell, None));
            } else {
                // Rung or not: it comes back.
                wait_any(&own, &bell, Some(now_ns() + 100_000));
            }
            bell[0].take_if_set();
        }
        over.store(true, Ordering::Relaxed);
    });
}

const CHILD: &str = "TROCAR_RT_TEST_CHILD";

/// Runs this test alone in a process with a limit; true in that process.
fn limited(test: &str, resource: libc::__rlimit_resource_t, most: u64) -> bool {
    if std::env::var_os(CHILD).is_some() {
        return true;
    }
    let mut child = Command::new(std::env::current_exe().unwrap());
    child.args(["--exact", test, "--nocapture", "--test-threads", "1"]).env(CHILD, "1");
    let limit = libc::rlimit { rlim_cur: most, rlim_max: most };
    // SAFETY: between fork and exec only a system call is made.
    unsafe {
        child.pre_exec(move || match libc::setrlimit(resource, &raw const limit) {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        })
    };
    let out = child.output().unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "{}: {said}", out.status);
    false
}

#[test]
fn memory_longer_than_a_file_may_be_is_refused_with_a_sentence() {
    let test = "memory_longer_than_a_file_may_be_is_refused_with_a_sentence";
    if !limited(test, libc::RLIMIT_FSIZE, 1 << 20) {
        return;
    }
    let why = FramePool::new(4, 64, 1 << 20).err().unwrap().to_string();
    assert!(why.contains("ulimit -f") && why.contains("1048576"), "{why}");
    let why = Region::shared(2 << 20).err().unwrap().to_string();
    assert!(why.contains("a link of 2097152 bytes"), "{why}");
    assert!(FramePool::new(4, 64, 1 << 10).is_ok(), "what fits is given");
}

#[test]
fn a_process_without_room_for_addresses_is_refused_memory_and_goes_on() {
    let test = "a_process_without_room_for_addresses_is_refused_memory_and_goes_on";
    if !limited(test, libc::RLIMIT_AS, 300 << 20) {
        return;
    }
    let why = FramePool::new(4, 64, 80 << 20).err().unwrap().to_string();
    assert!(why.contains("does not fit"), "{why}");
    let before = std::fs::read_dir("/proc/self/fd").unwrap().count();
    for _ in 0..3 {
        assert!(FramePool::new(4, 64, 80 << 20).is_err());
    }
    assert_eq!(std::fs::read_dir("/proc/self/fd").unwrap().count(), before, "a refusal left files open");
    assert!(FramePool::new(4, 64, 1 << 20).is_ok(), "what fits is given");
}

#[test]
fn a_process_that_may_open_no_more_files_is_refused_memory_until_it_may() {
    let test = "a_process_that_may_open_no_more_files_is_refused_memory_until_it_may";
    if !limited(test, libc::RLIMIT_NOFILE, 24) {
        return;
    }
    let held: Vec<_> = std::iter::from_fn(|| std::fs::File::open("/dev/null").ok()).collect();
    let why = Region::shared(4096).err().unwrap().to_string();
    assert!(why.contains("needs memfd_create") && why.contains("Too many open files"), "{why}");
    assert!(FramePool::new(4, 64, 64).is_err());
    drop(held);
    assert!(Region::shared(4096).is_ok() && FramePool::new(4, 64, 64).is_ok());
}
