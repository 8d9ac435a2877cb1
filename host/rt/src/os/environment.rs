//! The environment variables of the process, as far as they can be watched while other code may change them.
//!
//! Invariant: only the kernel reads foreign memory, and it answers with an error where a pointer does not
//! hold any more; nothing is ever changed, since no lock keeps other threads from reading.

use std::collections::BTreeMap;
use std::ffi::{c_char, c_void};
use std::sync::atomic::{AtomicPtr, Ordering};

/// Most variables, and most bytes of one, that are looked at.
const MOST: usize = 1 << 14;
const LONGEST: usize = 1 << 16;
/// No mapping ends within such a block.
const PAGE: usize = 4096;
/// Most names that are told.
const TOLD: usize = 6;

unsafe extern "C" {
    static mut environ: *mut *mut c_char;
}

/// The variables at one moment: the place of each one's text. `setenv`, `putenv` and `unsetenv` never write
/// into a text that is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Environment {
    texts: Vec<usize>,
}

impl Environment {
    /// Looks at the variables with some system calls; `None` where the kernel does not let a process read
    /// itself by them.
    pub fn look() -> Option<Environment> {
        // SAFETY: the C library's own variable, aligned and there as long as the process; whoever changes it
        // stores a whole pointer.
        let mut at = unsafe { AtomicPtr::from_ptr(&raw mut environ) }.load(Ordering::Acquire) as usize;
        let mut texts = Vec::new();
        while at != 0 {
            let block = to_end_of_page(at);
            for word in block.chunks_exact(size_of::<usize>()) {
                match word.try_into().map(usize::from_ne_bytes) {
                    Ok(text) if text != 0 && texts.len() < MOST => texts.push(text),
                    _ => return Some(Environment { texts }),
                }
            }
            // Pointers are aligned, so that each lies in one page.
            if block.is_empty() {
                return None;
            }
            at += block.len();
        }
        Some(Environment { texts })
    }

    /// Returns the changes since then, in words; `None` when there are none.
    pub fn said_since(&self, before: &Environment) -> Option<String> {
        let names = self.changed_since(before);
        (!names.is_empty()).then(|| {
            format!(
                "the environment of the process ({}), which stays so, since other threads may be reading it: all components \
                 here see it, programs the host starts do not; set it before the host starts, or give the component a \
                 process of its own (\"isolated\": true)",
                names.join(", ")
            )
        })
    }

    /// Returns the names of the variables that were set, unset or changed since; the last one says how many
    /// more.
    fn changed_since(&self, before: &Environment) -> Vec<String> {
        let new = |these: &Environment, those: &Environment| -> BTreeMap<String, Vec<u8>> {
            let new = these.texts.iter().filter(|text| !those.texts.contains(text));
            new.filter_map(|text| variable(*text)).collect()
        };
        if self == before {
            return Vec::new();
        }
        let (set, mut unset) = (new(self, before), new(before, self));
        // Another text with the same words is no change.
        let mut names: Vec<String> = set
            .into_iter()
            .filter(|(name, value)| unset.remove(name).as_ref() != Some(value))
            .map(|v| v.0)
            .collect();
        names.extend(unset.into_keys().filter(|name| !self.has(name)));
        names.sort();
        names.dedup();
        let more = names.len().saturating_sub(TOLD);
        names.truncate(TOLD);
        names.extend((more > 0).then(|| format!("{more} more")));
        names
    }

    fn has(&self, name: &str) -> bool {
        self.texts.iter().filter_map(|text| variable(*text)).any(|(other, _)| other == name)
    }
}

/// Returns name and value; `None` for a text that is no variable, or no text any more.
fn variable(at: usize) -> Option<(String, Vec<u8>)> {
    let mut text = Vec::new();
    let end = loop {
        let block = to_end_of_page(at + text.len());
        let end = block.iter().position(|byte| *byte == 0);
        text.extend_from_slice(&block[..end.unwrap_or(block.len())]);
        if end.is_some() || block.is_empty() || text.len() > LONGEST {
            break end;
        }
    };
    end?;
    let equals = text.iter().position(|byte| *byte == b'=')?;
    let (name, value) = (str::from_utf8(&text[..equals]).ok()?, text[equals + 1..].to_vec());
    let is_name = !name.is_empty() && name.bytes().all(|b| b.is_ascii_graphic());
    is_name.then(|| (name.to_owned(), value))
}

/// Returns the bytes from here to the end of the page, as the kernel reads them; none where there is no
/// memory.
fn to_end_of_page(at: usize) -> Vec<u8> {
    let mut block = vec![0; PAGE - at % PAGE];
    let own = libc::iovec { iov_base: block.as_mut_ptr().cast(), iov_len: block.len() };
    let read = libc::iovec { iov_base: at as *mut c_void, iov_len: block.len() };
    // SAFETY: the block is as long as is said; what is read from is checked by the kernel, and only read.
    let n = unsafe { libc::process_vm_readv(libc::getpid(), &raw const own, 1, &raw const read, 1, 0) };
    block.truncate(usize::try_from(n).unwrap_or(0));
    block
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;
    use std::sync::{Mutex, PoisonError};

    use super::*;

    fn set(name: &CStr, value: &CStr) {
        // SAFETY: texts that end; no other test of this crate touches the environment but behind this lock.
        unsafe { libc::setenv(name.as_ptr(), value.as_ptr(), 1) };
    }

    #[test]
    fn each_variable_that_is_set_changed_or_unset_is_named_and_none_that_stays() {
        static ONE: Mutex<()> = Mutex::new(());
        let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let look = || Environment::look().unwrap_or(Environment { texts: Vec::new() });
        let before = look();
        assert!(!before.texts.is_empty());
        set(c"TROCAR_TEST_A", c"1");
        set(c"TROCAR_TEST_B", c"1");
        let set_once = look();
        assert_eq!(set_once.changed_since(&before), ["TROCAR_TEST_A", "TROCAR_TEST_B"]);
        assert!(look().changed_since(&set_once).is_empty());
        set(c"TROCAR_TEST_A", c"2");
        let changed = look();
        assert_eq!(changed.changed_since(&set_once), ["TROCAR_TEST_A"]);
        set(c"TROCAR_TEST_A", c"2");
        assert!(look().changed_since(&changed).is_empty(), "the same value is no change");
        // SAFETY: a text that ends; as in `set`.
        unsafe { libc::unsetenv(c"TROCAR_TEST_B".as_ptr()) };
        assert_eq!(look().changed_since(&changed), ["TROCAR_TEST_B"]);
        let long: Vec<u8> = std::iter::repeat_n(b'x', 3 * PAGE).chain([0]).collect();
        set(c"TROCAR_TEST_LONG", CStr::from_bytes_with_nul(&long).unwrap_or_default());
        let with_long = look();
        assert_eq!(with_long.changed_since(&changed).first().map(String::as_str), Some("TROCAR_TEST_B"));
        let texts = with_long.texts.iter().filter_map(|text| variable(*text));
        let longest = texts.map(|(_, value)| value.len()).max();
        assert_eq!(longest, Some(3 * PAGE), "a text over several pages is read whole");
    }

    #[test]
    fn a_pointer_that_leads_nowhere_is_no_variable_and_no_crash() {
        assert_eq!(variable(8), None);
        assert_eq!(variable(usize::MAX - 10), None);
        let gone = Environment { texts: vec![8, 16, usize::MAX - 10] };
        assert!(Environment { texts: Vec::new() }.changed_since(&gone).is_empty());
    }
}
