//! A thread that ends leaves its marks, and those only, whatever the other end does with the page.
#![allow(clippy::unwrap_used)]

use std::mem::ManuallyDrop;
use std::sync::atomic::Ordering;

use trocar_rt::os::{Scope, futex_wait_each};
use trocar_rt::pulse::{Life, Pulse};
use trocar_rt::robust_words::RobustWords;

/// A page as its maker has it, and as the other end has it.
fn page() -> (Pulse, Pulse) {
    let made = Pulse::create([1, 2]).unwrap();
    let opened = Pulse::open(made.fd().unwrap().try_clone_to_owned().unwrap()).unwrap();
    (made, opened)
}

/// Runs on a thread of its own that ends as a killed one does: its words stand.
fn dies(does: impl FnOnce(&mut RobustWords) + Send + 'static) {
    let thread = std::thread::spawn(|| {
        let mut robust_words = ManuallyDrop::new(RobustWords::of_this_thread().unwrap());
        does(&mut robust_words);
    });
    thread.join().unwrap();
}

#[test]
fn either_end_of_a_page_is_told_that_the_thread_at_the_other_one_died() {
    let (made, opened) = page();
    assert_eq!((made.life(), opened.life()), (Life::Untold, Life::Untold));
    let (first, other) = (made, opened);
    let (tell, told) = std::sync::mpsc::channel();
    dies(move |robust_words| {
        robust_words.add(&first).unwrap();
        assert!(matches!(other.life(), Life::Lives(_)), "{:?}", other.life());
        assert_eq!(first.life(), Life::Untold, "the word is that of one end");
        tell.send(other).unwrap();
    });
    assert_eq!(told.recv().unwrap().life(), Life::Died);
    let (made, opened) = page();
    let theirs = Pulse::open(opened.fd().unwrap().try_clone_to_owned().unwrap()).unwrap();
    dies(move |robust_words| robust_words.add(&theirs).unwrap());
    assert_eq!(made.life(), Life::Died);
    assert_eq!(opened.life(), Life::Untold);
}

#[test]
fn of_many_pages_those_are_marked_that_were_not_taken_back_in_whatever_order_that_was() {
    for gone in [vec![], vec![0], vec![3], vec![1, 2], vec![3, 0], vec![2, 1, 0], vec![0, 1, 2, 3]] {
        let (made, opened): (Vec<Pulse>, Vec<Pulse>) = (0..4).map(|_| page()).unzip();
        let takes_back = gone.clone();
        dies(move |robust_words| {
            made.iter().for_each(|page| robust_words.add(page).unwrap());
            for at in takes_back {
                robust_words.remove(&made[at]);
                // A page that is not there is not taken back again.
                robust_words.remove(&made[at]);
            }
        });
        for (at, page) in opened.iter().enumerate() {
            let expected = if gone.contains(&at) { Life::Untold } else { Life::Died };
            assert_eq!(page.life(), expected, "page {at} of those without {gone:?}");
        }
    }
}

#[test]
fn a_list_that_is_dropped_marks_nothing_and_the_next_one_of_that_thread_does() {
    let ((first, seen), (second, seen_too)) = (page(), page());
    dies(move |robust_words| {
        let mut inner = {
            robust_words.add(&first).unwrap();
            RobustWords::of_this_thread()
        };
        assert!(
            inner.as_mut().is_err(),
            "one thread has one list: what the first one holds would be forgotten"
        );
    });
    assert_eq!(seen.life(), Life::Died);
    let thread = std::thread::spawn(move || {
        let mut robust_words = RobustWords::of_this_thread().unwrap();
        robust_words.add(&second).unwrap();
        drop(robust_words);
        let mut again = RobustWords::of_this_thread().unwrap();
        again.add(&second).unwrap();
        again.remove(&second);
    });
    thread.join().unwrap();
    assert_eq!(seen_too.life(), Life::Untold);
}

#[test]
fn whoever_writes_into_the_word_of_another_process_takes_the_mark_from_itself_only() {
    for nonsense in [0, 1, u32::MAX, libc::FUTEX_OWNER_DIED, libc::FUTEX_WAITERS | 1, 0x3fff_ffff] {
        let (scribbled, honest) = (page(), page());
        let (mine, theirs) = (scribbled.0, honest.0);
        let (seen, seen_too) = (scribbled.1, honest.1);
        let told = dies_with(move |robust_words| {
            robust_words.add(&mine).unwrap();
            robust_words.add(&theirs).unwrap();
            seen.life_word().store(nonsense, Ordering::Release);
            seen
        });
        assert_eq!(seen_too.life(), Life::Died, "the other page has its mark");
        assert_eq!(
            told.life_word().load(Ordering::Acquire),
            nonsense,
            "the kernel marks what is the thread's"
        );
    }
}

fn dies_with<R: Send + 'static>(does: impl FnOnce(&mut RobustWords) -> R + Send + 'static) -> R {
    let (tell, told) = std::sync::mpsc::channel();
    dies(move |robust_words| tell.send(does(robust_words)).unwrap());
    told.recv().unwrap()
}

#[test]
fn whoever_sleeps_on_the_word_is_woken_by_the_death() {
    let ((_, quiet), (made, seen)) = (page(), page());
    let (go, gone) = std::sync::mpsc::channel::<()>();
    let thread = std::thread::spawn(move || {
        let mut robust_words = ManuallyDrop::new(RobustWords::of_this_thread().unwrap());
        robust_words.add(&made).unwrap();
        // Until it is to end.
        let _ = gone.recv();
    });
    let word = loop {
        match seen.life() {
            Life::Lives(word) => break word,
            _ => std::thread::yield_now(),
        }
    };
    let sleeper = std::thread::spawn(move || {
        while seen.life() == Life::Lives(word) {
            let words = [(quiet.life_word(), 0, Scope::Machine), (seen.life_word(), word, Scope::Machine)];
            let woken = futex_wait_each(words.into_iter()).unwrap();
            assert!(matches!(woken, None | Some(1)), "woken by word {woken:?}");
        }
        seen.life()
    });
    drop(go);
    thread.join().unwrap();
    assert_eq!(sleeper.join().unwrap(), Life::Died);
}
