//! Settings of a thread that foreign code may change: signal mask and floating-point control word.
//!
//! Only the calling thread is looked at and changed; the floating-point word costs no system call.

/// Settings that should be the same before and after foreign code ran on a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hygiene {
    /// Blocked signals, bit 0 = signal 1.
    pub sigmask: u64,
    /// The floating-point control word: rounding mode, flush to zero, trap masks; as [`rounding`] gives it.
    pub rounding: u32,
}

/// Returns the settings of the calling thread. One system call.
pub fn thread_hygiene() -> Hygiene {
    Hygiene { sigmask: sigmask(), rounding: rounding() }
}

fn sigmask() -> u64 {
    // SAFETY: an all-zero sigset_t is a valid place for the answer; a null new set only asks.
    let set = unsafe {
        let mut set: libc::sigset_t = std::mem::zeroed();
        libc::pthread_sigmask(libc::SIG_BLOCK, std::ptr::null(), &mut set);
        set
    };
    // SAFETY: the set was written above; numbers 1 to 64 are within it.
    (1..=64).filter(|&s| unsafe { libc::sigismember(&set, s) } == 1).fold(0, |mask, s| mask | 1 << (s - 1))
}

/// Blocks exactly these signals in the calling thread (bit 0 = signal 1).
pub fn set_sigmask(mask: u64) {
    // SAFETY: the set is made here, from valid signal numbers; the call touches this thread only.
    unsafe {
        let mut set: libc::sigset_t = std::mem::zeroed();
        libc::sigemptyset(&mut set);
        for signal in (1..=64).filter(|s| mask & 1 << (s - 1) != 0) {
            libc::sigaddset(&mut set, signal);
        }
        libc::pthread_sigmask(libc::SIG_SETMASK, &set, std::ptr::null_mut());
    }
}

/// Status bits of MXCSR, which every operation may set.
#[cfg(target_arch = "x86_64")]
const STATUS: u32 = 0x3f;

/// Returns the floating-point control word of the calling thread. No system call.
#[cfg(target_arch = "x86_64")]
pub fn rounding() -> u32 {
    let mut word = 0u32;
    // SAFETY: stmxcsr writes four bytes to the address of `word`.
    unsafe { std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut word, options(nostack, preserves_flags)) };
    word & !STATUS
}

/// Puts a word of [`rounding`] back. No system call.
#[cfg(target_arch = "x86_64")]
pub fn reset_rounding(word: u32) {
    let word = word & !STATUS;
    // SAFETY: ldmxcsr reads four bytes; the word came from `rounding`, so no reserved bit is set.
    unsafe { std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const word, options(nostack, preserves_flags)) };
}

/// Returns the floating-point control word of the calling thread. No system call.
#[cfg(target_arch = "aarch64")]
pub fn rounding() -> u32 {
    let word: u64;
    // SAFETY: reading FPCR has no effect.
    unsafe { std::arch::asm!("mrs {}, fpcr", out(reg) word, options(nomem, nostack, preserves_flags)) };
    word as u32
}

/// Puts a word of [`rounding`] back. No system call.
#[cfg(target_arch = "aarch64")]
pub fn reset_rounding(word: u32) {
    // SAFETY: the word came from `rounding`.
    unsafe {
        std::arch::asm!("msr fpcr, {}", in(reg) u64::from(word), options(nomem, nostack, preserves_flags));
    }
}

/// Always returns 0: the word is not looked at on other processors.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub fn rounding() -> u32 {
    0
}

/// Does nothing where [`rounding`] sees nothing.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub fn reset_rounding(_word: u32) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_signal_mask_is_seen_and_can_be_put_back() {
        let before = thread_hygiene();
        set_sigmask(before.sigmask | 1 << 9);
        assert_ne!(thread_hygiene(), before);
        set_sigmask(before.sigmask);
        assert_eq!(thread_hygiene(), before);
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn a_changed_rounding_mode_is_seen_and_can_be_put_back() {
        let before = rounding();
        // Toward zero, and denormal numbers taken for zero and flushed to it.
        let changed = before | 0x6000 | 0x8040;
        reset_rounding(changed);
        let seen = rounding();
        reset_rounding(before);
        assert_eq!((seen, rounding()), (changed, before));
    }
}
