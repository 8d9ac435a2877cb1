//! A trap for tests: from now on the calling thread may make only the system calls of its own sleep and wake.
//!
//! Invariant: for a process that was made for it; whatever else is called ends that process, with the call's number as its
//! exit code.

use std::ffi::c_void;

/// What a sleeping and waking thread calls, and what ends the process.
const ALLOWED: [libc::c_long; 7] = [
    libc::SYS_futex,
    libc::SYS_clock_nanosleep,
    libc::SYS_clock_gettime,
    libc::SYS_sched_yield,
    libc::SYS_restart_syscall,
    libc::SYS_exit_group,
    libc::SYS_rt_sigreturn,
];

/// Offset of `si_syscall` in the `siginfo_t` of SIGSYS, bytes.
const SI_SYSCALL: usize = 24;

extern "C" fn caught(_: libc::c_int, info: *mut libc::siginfo_t, _: *mut c_void) {
    // SAFETY: the kernel hands over a siginfo of SIGSYS, which has the call's number there.
    let number = unsafe { info.cast::<u8>().add(SI_SYSCALL).cast::<i32>().read_unaligned() };
    // SAFETY: ends the process.
    unsafe { libc::_exit(number & 0xff) };
}

/// Sets the trap for the calling thread; false where the kernel has none.
pub(in crate::lcm) fn set() -> bool {
    let load = (libc::BPF_LD | libc::BPF_W | libc::BPF_ABS) as u16;
    let (equal, answer) =
        ((libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K) as u16, (libc::BPF_RET | libc::BPF_K) as u16);
    let op = |code, jt, jf, k| libc::sock_filter { code, jt, jf, k };
    // The number of the call stands first in what a filter sees.
    let mut program = [op(load, 0, 0, 0); ALLOWED.len() + 3];
    for (i, number) in ALLOWED.iter().enumerate() {
        program[i + 1] = op(equal, (ALLOWED.len() - i) as u8, 0, *number as u32);
    }
    program[ALLOWED.len() + 1] = op(answer, 0, 0, libc::SECCOMP_RET_TRAP);
    program[ALLOWED.len() + 2] = op(answer, 0, 0, libc::SECCOMP_RET_ALLOW);
    let filter = libc::sock_fprog { len: program.len() as u16, filter: program.as_mut_ptr() };
    // SAFETY: the handler only ends the process; the program lives for the calls, which concern this thread.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = caught as extern "C" fn(_, _, _) as usize;
        action.sa_flags = libc::SA_SIGINFO;
        libc::sigaction(libc::SIGSYS, &action, std::ptr::null_mut()) == 0
            && libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0
            && libc::prctl(libc::PR_SET_SECCOMP, libc::SECCOMP_MODE_FILTER, &raw const filter) == 0
    }
}
