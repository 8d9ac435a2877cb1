//! A journal that was cut or changed on the disk: its next GCM has what it can vouch for, or does not start.
//!
//! Invariant: each trial is of a copy of its own, so what a GCM leaves untouched is held against the copy
//! that was made for it.

use std::fs;
use std::path::Path;

use serde_json::json;

use crate::book::{Book, Timed};
use crate::clock::now_ns;
use crate::journal::said;
use crate::program::Program;
use crate::rpc::Rpc;
use crate::run::{Row, Run, When};
use crate::site::Site;

pub(crate) const ROWS: &[Row] =
    &[Row { name: "57", fault: "a journal that is cut or flipped", when: When::Gate, run: damaged }];

/// Components that are created one after the other: each is a record.
const MADE: usize = 16;
const JOURNAL: &str = "journal.redb";
/// End of a file whose write was torn.
const TAIL: usize = 4096;

/// Fate of a GCM at a damaged journal.
enum Outcome {
    Refused,
    /// It has so many of the components, and no other.
    Has(usize),
}

fn damaged(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let mut site = Site::new(&["fixture_torture"], &["a"])?;
    for n in 0..MADE {
        site.rpc.create(&format!("a/c{n}"), "fixture-torture/sink", json!({}))?;
    }
    site.kill_all(&["a", crate::site::GCM])?;
    let state = site.world.path("state/gcm");
    let whole = fs::read(state.join(JOURNAL)).map_err(|e| format!("{JOURNAL}: {e}"))?;
    let (mut refused, mut started, mut took, mut went) = (0, 0, Vec::new(), Ok(()));
    let tried = run.times(24, 2_000);
    for n in 0..tried {
        let mut bytes = whole.clone();
        let how = match n % 3 {
            0 => {
                bytes.truncate(random.usize(..whole.len()));
                format!("cut at {}", bytes.len())
            }
            1 => {
                bytes.truncate(whole.len() - random.usize(1..TAIL));
                format!("its tail cut at {}", bytes.len())
            }
            _ => {
                let (at, bit) = (random.usize(..whole.len()), random.u8(..8));
                bytes[at] ^= 1 << bit;
                format!("bit {bit} of byte {at} flipped")
            }
        };
        let began = now_ns();
        let outcome = tried_with(&site, &state, &bytes, n);
        took.push(Timed { ms: (now_ns() - began) as f64 / 1e6, late_ms: 0.0 });
        match outcome {
            Ok(Outcome::Refused) => refused += 1,
            // The last commit is all that a crash may have left unfinished.
            Ok(Outcome::Has(has)) if has + 1 >= MADE => started += 1,
            Ok(Outcome::Has(has)) => {
                went = Err(format!("{how}: it has {has} of {MADE}, and does not say so"))
            }
            Err(why) => went = Err(format!("{how}: {why}")),
        }
        if went.is_err() {
            break;
        }
    }
    book.check("it has what was decided, or it is refused and stays as it is (G1)", tried as usize, went);
    book.at_least("that were refused", tried as usize, refused, 1);
    book.at_least("that were good enough", tried as usize, started, 1);
    book.times("until that is known", &took, 1_000.0);
    book.leaves_out("a disk that is full, and one whose sync fails: host/src/journal/tests/storing.rs");
    // The journal itself was never touched.
    site.start_all(&[crate::site::GCM, "a"])?;
    site.await_all()?;
    let has = site.rpc.brief()?.components.len();
    let is = if has == MADE { Ok(()) } else { Err(format!("{has} of {MADE}")) };
    book.check("the whole one gives all of it", 1, is);
    site.down(book)
}

/// Starts a GCM at a copy with this journal.
fn tried_with(site: &Site, state: &Path, journal: &[u8], n: u64) -> Result<Outcome, String> {
    let copy = site.world.path(&format!("state/copy-{n}"));
    let failed = |e: std::io::Error| format!("{}: {e}", copy.display());
    fs::create_dir(&copy).map_err(failed)?;
    fs::copy(state.join("gcm.json"), copy.join("gcm.json")).map_err(failed)?;
    fs::write(copy.join(JOURNAL), journal).map_err(failed)?;
    let dir = copy.to_string_lossy().into_owned();
    let args = ["--json", "gcm", "--listen", "127.0.0.1:0", "--state", &dir].map(str::to_owned);
    let mut gcm = Program::begin(&site.world, "copy", &args, false)?;
    if gcm.await_address().is_err() {
        let printed = gcm.printed();
        if !printed.contains("JOURNAL_DAMAGED") {
            return Err(format!("it is not said that the journal is damaged: {printed}"));
        }
        let is_kept = fs::read(copy.join(JOURNAL)).map_err(failed)? == journal;
        fs::remove_dir_all(&copy).map_err(failed)?;
        return if is_kept { Ok(Outcome::Refused) } else { Err("the damaged file was written to".into()) };
    }
    let mut paths: Vec<String> =
        Rpc::at(&gcm.address).brief()?.components.into_iter().map(|c| c.path).collect();
    gcm.kill();
    said(&site.world, &["journal", "verify", "--state", &dir])?;
    fs::remove_dir_all(&copy).map_err(failed)?;
    paths.sort_by_key(|path| path.trim_start_matches("a/c").parse::<usize>().ok());
    let is_prefix = paths.iter().enumerate().all(|(n, path)| *path == format!("a/c{n}"));
    if is_prefix { Ok(Outcome::Has(paths.len())) } else { Err(format!("{paths:?}")) }
}
