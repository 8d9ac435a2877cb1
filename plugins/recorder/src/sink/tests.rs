//! Every route of bytes: the file is what was written, and at each flush readers find nothing else in it.

use std::fs::{File, OpenOptions};

use super::*;

/// Bytes from which can be seen where they belong.
fn pattern(from: u64, len: usize) -> Vec<u8> {
    (from..).take(len).map(|n| (n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8).collect()
}

fn new(dir: &tempfile::TempDir) -> (File, Sink) {
    let path = dir.path().join("a.mcap");
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path).expect("a new file");
    (File::open(path).expect("the file"), Sink::new(file))
}

/// When nothing is chosen yet by the clock.
fn far_ahead() -> Instant {
    Instant::now() + Duration::from_secs(3600)
}

/// Tells whether the written bytes are followed by one filler that ends with the file.
fn is_filler(rest: &[u8]) -> bool {
    rest.len() >= RECORD_HEAD
        && rest[0] == FILLER
        && rest[1..RECORD_HEAD] == ((rest.len() - RECORD_HEAD) as u64).to_le_bytes()
        && rest[RECORD_HEAD..].iter().all(|b| *b == 0)
}

fn content(file: &File) -> Vec<u8> {
    let mut bytes = vec![0; file.metadata().expect("its length").len() as usize];
    file.read_exact_at(&mut bytes, 0).expect("the file is read");
    bytes
}

/// Makes the sink take this route from now on, instead of the one that the clock would choose.
fn send_by(sink: &mut Sink, route: Route) {
    sink.looked.0 = far_ahead();
    if sink.route != Route::CachedOnly && sink.route != route {
        sink.take(route);
    }
}

/// The file begins with all that was written, and behind it is one filler at most: how long it is.
fn begins_with(file: &File, all: &[u8], when: &str) -> usize {
    let found = content(file);
    assert!(found.len() >= all.len(), "{when}: {} of {} B", found.len(), all.len());
    assert!(found[..all.len()] == all[..], "{when}: other bytes");
    let rest = &found[all.len()..];
    assert!(rest.is_empty() || is_filler(rest), "{when}: {} B behind it", rest.len());
    found.len()
}

#[test]
fn the_file_is_what_was_written_whichever_way_it_goes() {
    // Sizes around pages, around the memory's size, and several of it; around a filler's head before a page's
    // end.
    let sizes = [
        1,
        9,
        4086,
        4087,
        4088,
        4095,
        4096,
        4097,
        100_000,
        HOLDS - 1,
        HOLDS,
        HOLDS + 1,
        3 * HOLDS + 77,
        5,
        0,
        8191,
        8192,
        2,
        4000,
        90,
    ];
    for routes in [
        &[Route::Cached][..],
        &[Route::Direct],
        &[Route::CachedOnly],
        &[Route::Cached, Route::Direct],
        &[Route::Direct, Route::Direct, Route::Cached, Route::Cached, Route::Direct],
    ] {
        let dir = tempfile::tempdir().expect("a directory");
        let (file, mut sink) = new(&dir);
        let (mut all, mut longest) = (Vec::new(), 0);
        for (n, size) in sizes.iter().cycle().take(3 * sizes.len() + 1).enumerate() {
            send_by(&mut sink, routes[n % routes.len()]);
            let more = pattern(all.len() as u64, *size);
            sink.put(&more).expect("it is written");
            all.extend(more);
            if n % 4 == 3 {
                continue;
            }
            assert!(sink.flush(true).expect("it is flushed"), "not all of it");
            let len = begins_with(&file, &all, &format!("{routes:?} {n}"));
            assert!(routes.contains(&Route::Direct) || len == all.len(), "{routes:?} {n}: a filler");
            assert!(len >= longest, "{routes:?} {n}: made shorter, which gives back room");
            longest = len;
        }
        assert_eq!(sink.len(), all.len() as u64);
        let (stored, closed) = sink.close();
        closed.expect("it closes");
        assert_eq!(stored, all.len() as u64);
        assert!(content(&file)[..all.len()] == all, "{routes:?}: other bytes at the end");
    }
}

#[test]
fn what_is_not_urgent_waits_for_more_past_the_page_cache() {
    let dir = tempfile::tempdir().expect("a directory");
    let (file, mut sink) = new(&dir);
    sink.take(Route::Direct);
    if sink.route != Route::Direct {
        eprintln!("skip: the file system of the temporary directory knows the page cache only");
        return;
    }
    let mut put = |len: usize, urgent: bool| {
        send_by(&mut sink, Route::Direct);
        sink.put(&vec![1; len]).expect("it is written");
        let all = sink.flush(urgent).expect("it is flushed");
        (content(&file).len(), all)
    };
    assert_eq!(put(1000, false), (0, false));
    assert_eq!(put(WORTH, false), (WORTH + PAGE, true), "the last page is filled up");
    assert_eq!(put(PAGE, false), (WORTH + PAGE, false));
    assert_eq!(put(0, true), (WORTH + 2 * PAGE, true));
}

#[test]
fn much_passes_the_page_cache_by_and_little_does_not() {
    let dir = tempfile::tempdir().expect("a directory");
    let (_file, mut sink) = new(&dir);
    // As if so many bytes had come in exactly a second, in which the disk took so long, however long the
    // machine takes for it.
    let taken = |sink: &mut Sink, bytes: u64, waited: Duration| {
        let begun = Instant::now();
        sink.looked = (begun + Duration::from_secs(3600), 0);
        sink.put(&[7]).expect("it is written");
        sink.looked = (begun, sink.len());
        sink.at += bytes;
        sink.waited = waited;
        sink.choose_at(begun + Duration::from_secs(1));
        sink.flush(false).expect("it is flushed");
        sink.route
    };
    let second = |sink: &mut Sink, bytes: u64| taken(sink, bytes, Duration::ZERO);
    let little = second(&mut sink, 1 << 20);
    assert_eq!(little, Route::Cached);
    assert_eq!(second(&mut sink, 700 << 20), Route::Cached, "a burst");
    if second(&mut sink, 40 << 20) == Route::CachedOnly {
        eprintln!("skip: the file system of the temporary directory knows the page cache only");
        return;
    }
    assert_eq!(sink.route, Route::Direct);
    assert_eq!(second(&mut sink, 8 << 20), Route::Direct, "between the bounds it stays as it is");
    assert_eq!(second(&mut sink, 1 << 20), Route::Cached);
    // A disk that takes too long gets it through the page cache for a while.
    assert_eq!(second(&mut sink, 40 << 20), Route::Direct);
    assert_eq!(taken(&mut sink, 40 << 20, Duration::from_secs(100)), Route::Cached);
    assert_eq!(second(&mut sink, 40 << 20), Route::Cached, "not tried again at once");
    sink.not_before = Instant::now();
    assert_eq!(second(&mut sink, 40 << 20), Route::Direct);
}

#[test]
fn what_is_large_is_written_from_where_it_lies_and_the_records_around_it_are_whole() {
    let memory = Memory::new(20 * PAGE);
    for routes in
        [&[Route::Cached][..], &[Route::Direct], &[Route::CachedOnly], &[Route::Direct, Route::Cached]]
    {
        let dir = tempfile::tempdir().expect("a directory");
        let (file, mut sink) = new(&dir);
        let mut all: Vec<u8> = Vec::new();
        // Bodies that begin anywhere in memory, behind anything; once behind so much that memory gets full
        // within.
        for (n, (at, head)) in (0..120).map(|n| (n * 711 % (2 * PAGE), 1 + n * 97 % 5000)).enumerate() {
            send_by(&mut sink, routes[n % routes.len()]);
            if sink.route == Route::CachedOnly && routes.contains(&Route::Direct) {
                eprintln!("skip: the file system of the temporary directory knows the page cache only");
                return;
            }
            let head = pattern(all.len() as u64, if n % 50 == 7 { HOLDS - 100 + n } else { head });
            let (begin, len) = (memory.begin + at, 17 * PAGE - n);
            let body = &memory.bytes[begin..begin + len];
            let begins = sink.place(&head, body).expect("it is placed");
            assert_ne!(
                (sink.route, routes[0]),
                (Route::CachedOnly, Route::Direct),
                "{n}: the disk refused it"
            );
            let before = usize::try_from(begins).expect("a length") - all.len();
            assert!(before == 0 || (RECORD_HEAD..MOST_FILLER).contains(&before), "{routes:?} {n}: {before}");
            all.resize(begins as usize, 0);
            if before > 0 {
                all[begins as usize - before..][..RECORD_HEAD].copy_from_slice(&filler_head(before));
            }
            all.extend(&head);
            all.extend(body);
            if sink.route == Route::Direct {
                assert_eq!(
                    (all.len() - len) % PAGE,
                    body.as_ptr().addr() % PAGE,
                    "its pages would be copied"
                );
            }
            let small = pattern(7, n % 5 * 50);
            sink.put(&small).expect("it is written");
            all.extend(small);
            // Behind each of the routes, and before each.
            if n % 3 == 1 {
                sink.flush(true).expect("it is flushed");
                begins_with(&file, &all, &format!("{routes:?} {n}"));
            }
        }
        let (stored, closed) = sink.close();
        closed.expect("it closes");
        assert_eq!(stored, all.len() as u64);
        assert!(content(&file)[..all.len()] == all, "{routes:?}: other bytes at the end");
    }
}

#[test]
fn a_disk_that_takes_no_pages_past_the_page_cache_gets_them_through_it() {
    let dir = tempfile::tempdir().expect("a directory");
    let (file, mut sink) = new(&dir);
    sink.take(Route::Direct);
    // Memory that begins at no page is what disks refuse.
    sink.memory.begin += 1;
    let (head, body) = (pattern(0, 77), pattern(99, 33 * PAGE));
    let begins = sink.place(&head, &body).expect("it is placed") as usize;
    sink.flush(true).expect("it is flushed");
    assert_eq!(content(&file)[begins..][..head.len() + body.len()], [head, body].concat());
    assert_eq!(sink.route, Route::CachedOnly);
}
