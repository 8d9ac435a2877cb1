//! Every reason why a plugin file, a class or a plugin store is refused.
//!
//! Invariant: variants hold values; the sentence with its remedy is written once, in `Display`, and fits on
//! one line.

use std::fmt;
use std::path::PathBuf;

use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR};

use super::{Hash, libraries};

/// Why a plugin or a class cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub enum PluginError {
    /// One file is not acceptable.
    Refused { file: PathBuf, fault: Fault },
    /// No listed plugin offers the class; `refused` is a refused file whose name looks like the one asked
    /// for.
    ClassNotFound {
        asked: String,
        nearest: Option<String>,
        available: Vec<String>,
        refused: Option<Box<PluginError>>,
    },
    /// A short class name that several plugins offer.
    ClassAmbiguous { asked: String, offered: Vec<String> },
}

/// Fault of one file.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    Vanished,
    Unreadable {
        because: String,
    },
    /// The process or the machine has no file or memory left for it: the file itself was not judged.
    Shortage {
        because: String,
    },
    /// `kind` with its article: "a FIFO".
    NotRegular {
        kind: &'static str,
    },
    /// Sizes in bytes.
    TooLarge {
        size: u64,
        limit: u64,
    },
    ChangedWhileRead,
    Empty,
    NotElf {
        text: bool,
    },
    /// `what` lies at `needs` bytes, the file has `has`.
    Truncated {
        what: String,
        needs: u64,
        has: u64,
    },
    Malformed {
        what: String,
    },
    WrongMachine {
        built_for: String,
        host: &'static str,
    },
    Executable,
    /// An object file, a core dump: `kind` with its article.
    NotALibrary {
        kind: &'static str,
    },
    RunPath {
        path: String,
    },
    MissingLibrary {
        name: String,
    },
    LibraryByPath {
        name: String,
    },
    /// A library that the plugin brings is not acceptable.
    Library {
        name: String,
        fault: Box<Fault>,
    },
    /// A brought library is called as the plugin's copy in the cache.
    NameOfTheCopy,
    TooManyLibraries {
        limit: usize,
    },
    /// Another file is in the process under the name of a needed library.
    OtherLibrary {
        name: String,
        loaded: String,
    },
    NoNote,
    BadManifest {
        because: String,
    },
    Abi {
        plugin: [u32; 2],
    },
    PanicAbort,
    SameName {
        plugin: String,
        other: PathBuf,
    },
    WorldWritable {
        mode: u32,
    },
    GroupWritable {
        mode: u32,
    },
    ForeignOwner {
        owner: u32,
        own: u32,
    },
    Symlink,
    SymlinkLeadsOut,
    NotAllowed {
        hash: Hash,
        list: PathBuf,
    },
    UndefinedSymbol {
        symbol: String,
    },
    DlOpen {
        because: String,
    },
    NoEntry,
    Layout {
        difference: String,
    },
    /// The entry's table and the manifest disagree.
    EntryDiffers {
        what: String,
    },
    /// `during` completes "…while".
    Crashed {
        during: Stage,
        how: String,
        /// Its last words on standard error; empty when it had none. As in the two that follow.
        said: String,
    },
    Hung {
        during: Stage,
        seconds: u64,
        said: String,
    },
    Quit {
        during: Stage,
        code: i32,
        said: String,
    },
    VetFailed {
        because: String,
    },
    Cache {
        path: PathBuf,
        because: String,
    },
    Init {
        status: i32,
        /// Its last error in the log while it was tried.
        said: String,
    },
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

/// Why a store cannot be opened.
#[derive(Clone, Debug, PartialEq)]
pub enum StoreError {
    DirMissing { dir: PathBuf },
    DirNotADirectory { dir: PathBuf },
    DirUnreadable { dir: PathBuf, because: String },
    StateUnwritable { dir: PathBuf, because: String },
    StateForeign { dir: PathBuf, owner: u32 },
    StateNoExec { dir: PathBuf },
    TrustUnknown { asked: String },
    TrustSigned,
    AllowList { file: PathBuf, because: String },
}

impl PluginError {
    /// The reason code of the error table.
    pub fn reason(&self) -> &'static str {
        match self {
            PluginError::ClassNotFound { .. } | PluginError::ClassAmbiguous { .. } => "CLASS_NOT_FOUND",
            PluginError::Refused { fault, .. } => fault.reason(),
        }
    }

    /// The file a refusal is about.
    pub fn file(&self) -> Option<&PathBuf> {
        match self {
            PluginError::Refused { file, .. } => Some(file),
            _ => None,
        }
    }
}

impl Fault {
    pub fn reason(&self) -> &'static str {
        match self {
            Fault::Abi { .. } | Fault::Layout { .. } => "PLUGIN_ABI",
            Fault::WorldWritable { .. }
            | Fault::GroupWritable { .. }
            | Fault::ForeignOwner { .. }
            | Fault::Symlink
            | Fault::SymlinkLeadsOut
            | Fault::NotAllowed { .. } => "PLUGIN_UNTRUSTED",
            Fault::Library { fault, .. } => fault.reason(),
            _ => "PLUGIN_BAD_FILE",
        }
    }
}

impl Fault {
    /// The fault alone, without the library that has it.
    pub(super) fn root(&self) -> &Fault {
        match self {
            Fault::Library { fault, .. } => fault.root(),
            fault => fault,
        }
    }

    /// Tells whether the file itself is at fault: the same bytes fail again, whatever the system has then. A
    /// crash, a hang or an exit may be for want of a licence, a device or a service, which is there the next
    /// time.
    pub(super) fn is_of_the_file(&self) -> bool {
        matches!(self, Fault::NoEntry | Fault::Layout { .. } | Fault::EntryDiffers { .. })
    }
}

impl std::error::Error for PluginError {}
impl std::error::Error for StoreError {}

impl fmt::Display for PluginError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PluginError::Refused { file, fault } => {
                let name = file.file_name().map_or_else(|| file.to_string_lossy(), |n| n.to_string_lossy());
                write!(f, "{name}: {fault}")
            }
            PluginError::ClassNotFound { asked, nearest, available, refused } => {
                write!(f, "no class `{asked}` in any listed plugin")?;
                if let Some(name) = nearest {
                    write!(f, "; did you mean `{name}`?")?;
                }
                match available.is_empty() {
                    true => write!(f, "; no plugin is listed: put its .so into a plugin directory")?,
                    false => write!(f, "; available: {}", available.join(", "))?,
                }
                if let Some(error) = refused {
                    write!(f, "; a file of that name is refused: {error}")?;
                }
                Ok(())
            }
            PluginError::ClassAmbiguous { asked, offered } => {
                write!(f, "class `{asked}` is offered by several plugins: say {}", offered.join(" or "))
            }
        }
    }
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

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::Vanished => write!(f, "the file is gone: copy it into the plugin directory again"),
            Fault::Shortage { because } => write!(
                f,
                "cannot be read now ({because}): the process has no files or memory left, restart it with more of them (`ulimit -n`)"
            ),
            Fault::Unreadable { because } => write!(f, "cannot be read ({because}): check its permissions"),
            Fault::NotRegular { kind } => {
                write!(f, "is {kind}, not a regular file: put the shared library itself here")
            }
            Fault::TooLarge { size, limit } => write!(
                f,
                "is {} MiB long, a plugin may have {} MiB with the libraries it brings: strip it or check what was copied",
                size >> 20,
                limit >> 20
            ),
            Fault::ChangedWhileRead => {
                write!(f, "changed while it was read: write it under another name, then rename it")
            }
            Fault::Empty => write!(f, "is empty: copy it again"),
            Fault::NotElf { text: true } => {
                write!(f, "is a text file, not a shared library: put a compiled .so here")
            }
            Fault::NotElf { text: false } => {
                write!(f, "is not an ELF file, so not a shared library: put a compiled .so here")
            }
            Fault::Truncated { what, needs, has } => write!(
                f,
                "is truncated: {what} needs {needs} bytes of file, it has {has}: copy it again, completely"
            ),
            Fault::Malformed { what } => write!(f, "is a damaged ELF file: {what}: copy or build it again"),
            Fault::WrongMachine { built_for, host } => {
                write!(f, "is built for {built_for}, this host is {host}: build it for {host}")
            }
            Fault::Executable => write!(
                f,
                "is an executable, not a shared library: build it with crate-type cdylib (Rust) or -shared (C, C++)"
            ),
            Fault::NotALibrary { kind } => {
                write!(f, "is {kind}, not a shared library: link it with -shared")
            }
            Fault::RunPath { path } if path.is_empty() => write!(
                f,
                "carries an empty library search path, which is the working directory: link it with \
                 -Wl,-rpath,'$ORIGIN' alone, or without -rpath"
            ),
            Fault::RunPath { path } => write!(
                f,
                "carries the library search path `{path}`: put its libraries into the plugin's own directory (not below it) and link \
                 it with -Wl,-rpath,'$ORIGIN'; or put them where the system looks (a directory in /etc/ld.so.conf.d, then ldconfig)"
            ),
            Fault::Library { name, fault } => write!(f, "brings the library `{name}`, which {fault}"),
            Fault::NameOfTheCopy => write!(
                f,
                "has the name that the plugin itself has in the cache: give the library another name (-Wl,-soname), or the plugin"
            ),
            Fault::TooManyLibraries { limit } => write!(
                f,
                "brings more than {limit} libraries: install them where the system looks (a directory in /etc/ld.so.conf.d, then \
                 ldconfig)"
            ),
            Fault::OtherLibrary { name, loaded } => write!(
                f,
                "needs another `{name}` than this process has loaded already ({loaded}), and the dynamic linker keeps one of each \
                 name: give all plugins the same file, let its components run in a process of their own (\"isolation\"), or restart \
                 the host where that is the library of a former version"
            ),
            Fault::MissingLibrary { name } => write!(
                f,
                "needs the library `{name}`, which is not found: install it, link it statically, or put it beside the plugin and link \
                 that with -Wl,-rpath,'$ORIGIN'{}. It is looked for again every 2 s",
                if libraries::is_secured() {
                    ". LD_LIBRARY_PATH does not count, since this program has file capabilities or another user's rights; name the \
                     directory in /etc/ld.so.conf.d, then run ldconfig"
                } else {
                    ""
                }
            ),
            Fault::LibraryByPath { name } => write!(
                f,
                "needs a library by its path `{name}`: link with -l so that the system's search applies"
            ),
            Fault::NoNote => write!(
                f,
                "is a shared library but no trocar plugin (no .note.trocar): end it with trocar_plugin!(…) \
                 or TROCAR_MANIFEST in C"
            ),
            Fault::BadManifest { because } => {
                write!(f, "has a manifest this host cannot use: {because}: correct and rebuild the plugin")
            }
            Fault::Abi { plugin: [major, minor] } => {
                let remedy = if *major > ABI_MAJOR { "update the host, or rebuild" } else { "rebuild" };
                write!(
                    f,
                    "speaks ABI {major}.{minor}, this host speaks {ABI_MAJOR}.{ABI_MINOR}: {remedy} the plugin \
                     with trocar-sdk {ABI_MAJOR}.x"
                )
            }
            Fault::PanicAbort => write!(
                f,
                "was built with panic = \"abort\", so a panic would end the whole host: build it with \
                 panic = \"unwind\""
            ),
            Fault::SameName { plugin, other } => {
                write!(f, "has the same plugin name `{plugin}` as {}: remove one of the two", other.display())
            }
            Fault::WorldWritable { mode } => {
                write!(f, "can be written by everybody (mode {:o}): run chmod go-w on it", mode & 0o7777)
            }
            Fault::GroupWritable { mode } => {
                write!(f, "can be written by its group (mode {:o}): run chmod g-w on it", mode & 0o7777)
            }
            Fault::ForeignOwner { owner, own } => write!(
                f,
                "belongs to user {owner}, this host runs as user {own} and takes only its own and root's files: \
                 copy or chown it"
            ),
            Fault::Symlink => write!(f, "is a symbolic link, which this trust mode refuses: copy the file"),
            Fault::SymlinkLeadsOut => {
                write!(f, "is a symbolic link that leads out of the plugin directory: copy the file")
            }
            Fault::NotAllowed { hash, list } => write!(
                f,
                "is not in the allow list {}: if you trust it, add its sha256 {hash} there and restart the host, which reads the \
                 list when it starts",
                list.display()
            ),
            Fault::UndefinedSymbol { symbol } => write!(
                f,
                "uses the symbol `{symbol}`, which nothing defines: link the library that has it (-Wl,-z,defs \
                 finds this at build time)"
            ),
            Fault::DlOpen { because } if because.contains("static TLS") => write!(
                f,
                "cannot be loaded: {because}: each version that was loaded keeps its part of a small room until the process ends. \
                 Restart the host; where one version is refused, build it with -ftls-model=global-dynamic, or start the host with \
                 GLIBC_TUNABLES=glibc.rtld.optional_static_tls=16384"
            ),
            Fault::DlOpen { because } => write!(
                f,
                "cannot be loaded ({because}): correct what the dynamic linker says; `trocar plugin check FILE` tries it again"
            ),
            Fault::NoEntry => write!(
                f,
                "has a manifest but does not export `trocar_plugin_v1`: export it (visibility default), then rebuild"
            ),
            Fault::Layout { difference } => write!(
                f,
                "was built with another layout of the contract: {difference}: rebuild it with trocar-sdk {ABI_MAJOR}.x"
            ),
            Fault::EntryDiffers { what } => {
                write!(
                    f,
                    "has a manifest and tables that do not fit: {what}: correct the plugin, or rebuild it completely"
                )
            }
            Fault::Crashed { during, how, said } => write!(
                f,
                "crashes while {during} ({how}){}; it was tried in a child process, this host is not affected, and it is tried again \
                 when it is asked for: debug it with `trocar __vet FILE`",
                Words(said)
            ),
            Fault::Hung { during, seconds, said } => write!(
                f,
                "does not come back within {seconds} s while {during}{}; the child process that tried it was ended, and it is tried \
                 again when it is asked for: do slow work in `configure` or `start`",
                Words(said)
            ),
            Fault::Quit { during, code, said } => {
                write!(
                    f,
                    "ends the process with code {code} while {during}{}: a plugin must not call exit",
                    Words(said)
                )
            }
            Fault::VetFailed { because } => write!(
                f,
                "could not be tried in a child process ({because}): see that the program is still there and may start processes \
                 (`ulimit -u`), then ask again"
            ),
            Fault::Cache { path, because } => write!(
                f,
                "cannot be copied to the plugin cache {}: {because}: free or repair the state directory",
                path.display()
            ),
            Fault::Init { status, said } if said.is_empty() => {
                write!(
                    f,
                    "refuses to work (its init answers {status}): see what it said in the log, then ask again"
                )
            }
            Fault::Init { said, .. } => {
                write!(f, "refuses to work (\"{said}\"): give it what it lacks, then ask again")
            }
        }
    }
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            StoreError::DirMissing { dir } => {
                write!(
                    f,
                    "plugin directory {} does not exist: create it with mkdir -p, or name another",
                    dir.display()
                )
            }
            StoreError::DirNotADirectory { dir } => {
                write!(f, "{} is not a directory: name the directory that holds the plugins", dir.display())
            }
            StoreError::DirUnreadable { dir, because } => write!(
                f,
                "plugin directory {} cannot be read ({because}): give this user read and execute permission",
                dir.display()
            ),
            StoreError::StateUnwritable { dir, because } => write!(
                f,
                "state directory {} cannot be written ({because}): name a writable one with --state DIR",
                dir.display()
            ),
            StoreError::StateForeign { dir, owner } => write!(
                f,
                "{} belongs to user {owner}, who could exchange plugins in it: name an own one with --state DIR",
                dir.display()
            ),
            StoreError::StateNoExec { dir } => write!(
                f,
                "{} is on a filesystem mounted noexec, plugins cannot be loaded from it: name another with --state DIR",
                dir.display()
            ),
            StoreError::TrustUnknown { asked } => {
                write!(f, "no trust mode `{asked}`: say dev or allowlist:FILE")
            }
            StoreError::TrustSigned => write!(
                f,
                "trust mode `signed` is not in this version: say allowlist:FILE to load known files only, or dev"
            ),
            StoreError::AllowList { file, because } => write!(
                f,
                "allow list {} cannot be used: {because}: it is a file of your own with {{\"sha256\":[\"…\"]}}",
                file.display()
            ),
        }
    }
}
