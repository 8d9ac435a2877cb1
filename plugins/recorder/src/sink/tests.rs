//! Whatever goes which way: the file is what was written, and at each flush readers find nothing else in it.

use std::fs::{File, OpenOptions};

use super::*;

/// Bytes from which can be seen where they belong.
fn pattern(from: u64, len: usize) -> Vec<u8> {
    (from..).take(len).map(|n| (n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8).collect()
}

fn new(dir: &tempfile::TempDir) -> (File, Sink, Arc<Word>) {
    let path = dir.path().join("a.mcap");
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path).expect("a new file");
    let word = Arc::new(Word::default());
    (File::open(path).expect("the file"), Sink::new(file, word.clone()), word)
}

/// When nothing is chosen yet by the clock.
fn far_ahead() -> Instant {
    Instant::now() + Duration::from_secs(3600)
}

/// What follows the written bytes is one filler that ends with the file.
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

#[test]
fn the_file_is_what_was_written_whichever_way_it_goes() {
    // Sizes around pages, around what the memory holds, and several of it; around a filler's head before a page's end.
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
        let (file, mut sink, word) = new(&dir);
        let (mut all, mut longest) = (Vec::new(), 0);
        for (n, size) in sizes.iter().cycle().take(3 * sizes.len() + 1).enumerate() {
            // What it is told to take, not what the clock makes it.
            sink.looked.0 = far_ahead();
            let route = routes[n % routes.len()];
            if sink.route != Route::CachedOnly && sink.route != route {
                sink.take(route);
            }
            let more = pattern(all.len() as u64, *size);
            sink.write_all(&more).expect("it is written");
            all.extend(more);
            if n % 4 == 3 {
                continue;
            }
            word.urgent.store(true, Ordering::Relaxed);
            sink.flush().expect("it is flushed");
            let found = content(&file);
            assert!(found.len() >= all.len(), "{routes:?} {n}: {} of {} B", found.len(), all.len());
            assert!(found[..all.len()] == all[..], "{routes:?} {n}: other bytes");
            let rest = &found[all.len()..];
            assert!(rest.is_empty() || is_filler(rest), "{routes:?} {n}: {} B behind it", rest.len());
            assert!(routes.contains(&Route::Direct) || rest.is_empty(), "{routes:?} {n}: a filler");
            assert!(found.len() >= longest, "{routes:?} {n}: made shorter, which gives back room");
            longest = found.len();
        }
        assert_eq!(word.len.load(Ordering::Relaxed), all.len() as u64);
        let (stored, closed) = sink.close();
        closed.expect("it closes");
        assert_eq!(stored, all.len() as u64);
        assert!(content(&file)[..all.len()] == all, "{routes:?}: other bytes at the end");
    }
}

#[test]
fn what_is_not_urgent_waits_for_more_past_the_page_cache() {
    let dir = tempfile::tempdir().expect("a directory");
    let (file, mut sink, word) = new(&dir);
    sink.take(Route::Direct);
    if sink.route != Route::Direct {
        eprintln!("skip: the file system of the temporary directory knows the page cache only");
        return;
    }
    let mut put = |len: usize| {
        // What it was told to take, not what the clock makes it.
        sink.looked.0 = far_ahead();
        sink.write_all(&vec![1; len]).expect("it is written");
        sink.flush().expect("it is flushed");
        content(&file).len()
    };
    assert_eq!(put(1000), 0);
    assert_eq!(put(WORTH), WORTH + PAGE, "the last page is filled up");
    assert_eq!(put(PAGE), WORTH + PAGE);
    word.urgent.store(true, Ordering::Relaxed);
    assert_eq!(put(0), WORTH + 2 * PAGE);
}

#[test]
fn much_passes_the_page_cache_by_and_little_does_not() {
    let dir = tempfile::tempdir().expect("a directory");
    let (_file, mut sink, word) = new(&dir);
    // As if so many bytes had come in a second.
    let second = |sink: &mut Sink, bytes: u64| {
        sink.write_all(&[7]).expect("it is written");
        word.len.fetch_add(bytes - 1, Ordering::Relaxed);
        sink.looked.0 = Instant::now().checked_sub(Duration::from_secs(1)).expect("a clock that has run");
        sink.flush().expect("it is flushed");
        sink.route
    };
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
    sink.waited = Duration::from_secs(100);
    assert_eq!(second(&mut sink, 40 << 20), Route::Cached);
    assert_eq!(second(&mut sink, 40 << 20), Route::Cached, "not tried again at once");
    sink.not_before = Instant::now();
    assert_eq!(second(&mut sink, 40 << 20), Route::Direct);
}
