//! Every reason why one plugin file is refused.

use std::fmt;
use std::path::PathBuf;

use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR};

use crate::{Hash, libraries};

// Reason codes of the host's refusals.
const ABI: &str = "PLUGIN_ABI";
const UNTRUSTED: &str = "PLUGIN_UNTRUSTED";
const BAD_FILE: &str = "PLUGIN_BAD_FILE";

errors! {
    /// Fault of one file.
    pub enum Fault;

    Vanished => (BAD_FILE, "the file is gone: copy it into the plugin directory again"),
    Unreadable { because: String } => (BAD_FILE, format!(
        "cannot be read ({because}): check its permissions"
    )),
    /// The process or the machine has no file or memory left for it: the file itself was not judged.
    Shortage { because: String } => (BAD_FILE, format!(
        "cannot be read now ({because}): the process has no files or memory left, restart it with more of \
         them (`ulimit -n`)"
    )),
    /// `kind` with its article: "a FIFO".
    NotRegular { kind: &'static str } => (BAD_FILE, format!(
        "is {kind}, not a regular file: put the shared library itself here"
    )),
    /// Sizes in bytes.
    TooLarge { size: u64, limit: u64 } => (BAD_FILE, format!(
        "is {} MiB long, a plugin may have {} MiB with the libraries it brings: strip it or check what was \
         copied",
        size >> 20,
        limit >> 20
    )),
    ChangedWhileRead => (BAD_FILE, "changed while it was read: write it under another name, then rename it"),
    Empty => (BAD_FILE, "is empty: copy it again"),
    NotElf { text: bool } => (BAD_FILE, match text {
        true => "is a text file, not a shared library: put a compiled .so here",
        false => "is not an ELF file, so not a shared library: put a compiled .so here",
    }),
    /// `what` lies at `needs` bytes, the file has `has`.
    Truncated { what: String, needs: u64, has: u64 } => (BAD_FILE, format!(
        "is truncated: {what} needs {needs} bytes of file, it has {has}: copy it again, completely"
    )),
    Malformed { what: String } => (BAD_FILE, format!(
        "is a damaged ELF file: {what}: copy or build it again"
    )),
    WrongMachine { built_for: String, host: &'static str } => (BAD_FILE, format!(
        "is built for {built_for}, this host is {host}: build it for {host}"
    )),
    Executable => (
        BAD_FILE,
        "is an executable, not a shared library: build it with crate-type cdylib (Rust) or -shared (C, C++)",
    ),
    /// An object file, a core dump: `kind` with its article.
    NotALibrary { kind: &'static str } => (BAD_FILE, format!(
        "is {kind}, not a shared library: link it with -shared"
    )),
    RunPath { path: String } => (BAD_FILE, match path.as_str() {
        "" => "carries an empty library search path, which is the working directory: link it with \
               -Wl,-rpath,'$ORIGIN' alone, or without -rpath"
            .into(),
        path => format!(
            "carries the library search path `{path}`: put its libraries into the plugin's own directory \
             (not below it) and link it with -Wl,-rpath,'$ORIGIN'; or put them where the system looks (a \
             directory in /etc/ld.so.conf.d, then ldconfig)"
        ),
    }),
    MissingLibrary { name: String } => (BAD_FILE, format!(
        "needs the library `{name}`, which is not found: install it, link it statically, or put it beside \
         the plugin and link that with -Wl,-rpath,'$ORIGIN'{}. It is looked for again every 2 s",
        match libraries::is_secured() {
            true => ". LD_LIBRARY_PATH does not count, since this program has file capabilities or another \
                     user's rights; name the directory in /etc/ld.so.conf.d, then run ldconfig",
            false => "",
        }
    )),
    LibraryByPath { name: String } => (BAD_FILE, format!(
        "needs a library by its path `{name}`: link with -l so that the system's search applies"
    )),
    /// A library that the plugin brings is not acceptable.
    Library { name: String, fault: Box<Fault> } => (fault.reason(), format!(
        "brings the library `{name}`, which {fault}"
    )),
    /// A brought library is called as the plugin's copy in the cache.
    NameOfTheCopy => (
        BAD_FILE,
        "has the name that the plugin itself has in the cache: give the library another name (-Wl,-soname), \
         or the plugin",
    ),
    TooManyLibraries { limit: usize } => (BAD_FILE, format!(
        "brings more than {limit} libraries: install them where the system looks (a directory in \
         /etc/ld.so.conf.d, then ldconfig)"
    )),
    /// Another file is in the process under the name of a needed library.
    OtherLibrary { name: String, loaded: String } => (BAD_FILE, format!(
        "needs another `{name}` than this process has loaded already ({loaded}), and the dynamic linker \
         keeps one of each name: give all plugins the same file, let its components run in a process of \
         their own (\"isolation\"), or restart the host where that is the library of a former version"
    )),
    NoNote => (
        BAD_FILE,
        "is a shared library but no trocar plugin (no .note.trocar): end it with trocar_plugin!(…) or \
         TROCAR_MANIFEST in C",
    ),
    BadManifest { because: String } => (BAD_FILE, format!(
        "has a manifest this host cannot use: {because}: correct and rebuild the plugin"
    )),
    Abi { plugin: [u32; 2] } => (ABI, {
        let [major, minor] = plugin;
        let remedy = if *major > ABI_MAJOR { "update the host, or rebuild" } else { "rebuild" };
        format!(
            "speaks ABI {major}.{minor}, this host speaks {ABI_MAJOR}.{ABI_MINOR}: {remedy} the plugin with \
             trocar-sdk {ABI_MAJOR}.x"
        )
    }),
    PanicAbort => (
        BAD_FILE,
        "was built with panic = \"abort\", so a panic would end the whole host: build it with panic = \
         \"unwind\"",
    ),
    SameName { plugin: String, other: PathBuf } => (BAD_FILE, format!(
        "has the same plugin name `{plugin}` as {}: remove one of the two",
        other.display()
    )),
    WorldWritable { mode: u32 } => (UNTRUSTED, format!(
        "can be written by everybody (mode {:o}): run chmod go-w on it",
        mode & 0o7777
    )),
    GroupWritable { mode: u32 } => (UNTRUSTED, format!(
        "can be written by its group (mode {:o}): run chmod g-w on it",
        mode & 0o7777
    )),
    ForeignOwner { owner: u32, own: u32 } => (UNTRUSTED, format!(
        "belongs to user {owner}, this host runs as user {own} and takes only its own and root's files: copy \
         or chown it"
    )),
    Symlink => (UNTRUSTED, "is a symbolic link, which this trust mode refuses: copy the file"),
    SymlinkLeadsOut => (
        UNTRUSTED,
        "is a symbolic link that leads out of the plugin directory: copy the file",
    ),
    NotAllowed { hash: Hash, list: PathBuf } => (UNTRUSTED, format!(
        "is not in the allow list {}: if you trust it, add its sha256 {hash} there and restart the host, \
         which reads the list when it starts",
        list.display()
    )),
    UndefinedSymbol { symbol: String } => (BAD_FILE, format!(
        "uses the symbol `{symbol}`, which nothing defines: link the library that has it (-Wl,-z,defs finds \
         this at build time)"
    )),
    DlOpen { because: String } => (BAD_FILE, match because.contains("static TLS") {
        true => format!(
            "cannot be loaded: {because}: each version that was loaded keeps its part of a small room until \
             the process ends. Restart the host; where one version is refused, build it with \
             -ftls-model=global-dynamic, or start the host with \
             GLIBC_TUNABLES=glibc.rtld.optional_static_tls=16384"
        ),
        false => format!(
            "cannot be loaded ({because}): correct what the dynamic linker says; `trocar plugin check FILE` \
             tries it again"
        ),
    }),
    NoEntry => (
        BAD_FILE,
        "has a manifest but does not export `trocar_plugin_v1`: export it (visibility default), then rebuild",
    ),
    Layout { difference: String } => (ABI, format!(
        "was built with another layout of the contract: {difference}: rebuild it with trocar-sdk \
         {ABI_MAJOR}.x"
    )),
    /// The entry's table and the manifest disagree.
    EntryDiffers { what: String } => (BAD_FILE, format!(
        "has a manifest and tables that do not fit: {what}: correct the plugin, or rebuild it completely"
    )),
    /// `during` completes "…while".
    Crashed {
        during: Stage,
        how: String,
        /// Its last words on standard error; empty when it had none. As in the two that follow.
        said: String,
    } => (BAD_FILE, format!(
        "crashes while {during} ({how}){}; it was tried in a child process, this host is not affected, and \
         it is tried again when it is asked for: debug it with `trocar __vet FILE`",
        Words(said)
    )),
    Hung { during: Stage, seconds: u64, said: String } => (BAD_FILE, format!(
        "does not come back within {seconds} s while {during}{}; the child process that tried it was ended, \
         and it is tried again when it is asked for: do slow work in `configure` or `start`",
        Words(said)
    )),
    Quit { during: Stage, code: i32, said: String } => (BAD_FILE, format!(
        "ends the process with code {code} while {during}{}: a plugin must not call exit",
        Words(said)
    )),
    VetFailed { because: String } => (BAD_FILE, format!(
        "could not be tried in a child process ({because}): see that the program is still there and may \
         start processes (`ulimit -u`), then ask again"
    )),
    Cache { path: PathBuf, because: String } => (BAD_FILE, format!(
        "cannot be copied to the plugin cache {}: {because}: free or repair the state directory",
        path.display()
    )),
    Init {
        status: i32,
        /// Its last error in the log while it was tried.
        said: String,
    } => (BAD_FILE, match said.as_str() {
        "" => format!(
            "refuses to work (its init answers {status}): see what it said in the log, then ask again"
        ),
        said => format!("refuses to work (\"{said}\"): give it what it lacks, then ask again"),
    }),
}

impl Fault {
    /// The fault alone, without the library that has it.
    pub(crate) fn root(&self) -> &Fault {
        match self {
            Fault::Library { fault, .. } => fault.root(),
            fault => fault,
        }
    }

    /// Tells whether the file itself is at fault: the same bytes fail again, whatever the system has then. A
    /// crash, a hang or an exit may be for want of a licence, a device or a service, which is there the next
    /// time.
    pub(crate) fn is_of_the_file(&self) -> bool {
        matches!(self, Fault::NoEntry | Fault::Layout { .. } | Fault::EntryDiffers { .. })
    }
}

/// Last stage the vetting child reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// dlopen: constructors of global objects.
    Loading,
    Layout,
    Entry,
    Init,
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Stage::Loading => "its constructors run (dlopen)",
            Stage::Layout => "its layout description is read",
            Stage::Entry => "its entry is called",
            Stage::Init => "its init is called",
        })
    }
}

/// Words of the code before it ended, where it did.
struct Words<'a>(&'a str);

impl fmt::Display for Words<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() { Ok(()) } else { write!(f, ", saying \"{}\"", self.0) }
    }
}
