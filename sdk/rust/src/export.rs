//! `trocar_plugin!` and `static_plugin!`: the manifest, the tables, and for a `.so` the note and the exported
//! symbol.
//!
//! Invariant: everything the macros emit is const data, so a host can read the manifest without running a
//! byte.

/// Exports component classes as a plugin: `trocar_plugin!(LowPass, Notch);`, once per `cdylib` crate.
///
/// The plugin's name is the crate's without a leading `trocar-`; version, licence and description are the
/// crate's. `trocar_plugin!(LowPass; unload)` says that the library may be unmapped when no instance is left:
/// it starts no threads and leaves nothing behind.
///
/// A build for tests (`cfg(test)`) exports nothing, so the tests of a plugin may have one other plugin as a
/// `dev-dependency` and drive both on benches.
#[macro_export]
macro_rules! trocar_plugin {
    ($($class:ty),+ $(,)?) => { $crate::__trocar_plugin!(false, $($class),+); };
    ($($class:ty),+ ; unload) => { $crate::__trocar_plugin!(true, $($class),+); };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __trocar_plugin {
    ($unload:literal, $($class:ty),+) => {
        const _: () = {
            $crate::__trocar_tables!($crate::__private::plugin_name(env!("CARGO_PKG_NAME")), $unload, $($class),+);

            #[used]
            #[unsafe(link_section = ".note.trocar")]
            static NOTE: p::Note<LEN> = p::Note::new(TEXT);

            $crate::__trocar_layout!();

            // Not in a plugin's own tests, so that they can link another plugin, which exports the same name.
            #[cfg_attr(not(test), unsafe(no_mangle))]
            #[cfg_attr(test, allow(dead_code))]
            extern "C" fn trocar_plugin_v1() -> *const p::PluginTable {
                &raw const TABLE.0
            }
        };
    };
}

/// The same classes as a plugin without a file, for a host they are linked into:
/// `pub const FILTERS: StaticPlugin = static_plugin!(LowPass, Notch);`.
///
/// The plugin exports no symbol, so any number of crates with one can be linked together. A crate that is a
/// `.so` as well puts its [`trocar_plugin!`] behind a Cargo feature.
/// `static_plugin!(name = "notches", Notch)` gives it another name than the crate's.
///
/// ```
/// use trocar_sdk::{StaticPlugin, prelude::*, static_plugin};
/// #[derive(Component)]
/// struct Lamp {}
/// impl Component for Lamp {}
/// const LAMPS: StaticPlugin = static_plugin!(name = "lamps", Lamp);
/// assert!(LAMPS.manifest.contains("\"name\":\"lamp\""));
/// ```
#[macro_export]
macro_rules! static_plugin {
    (name = $name:literal, $($class:ty),+ $(,)?) => { $crate::__static_plugin!($name, $($class),+) };
    ($($class:ty),+ $(,)?) => {
        $crate::__static_plugin!($crate::__private::plugin_name(env!("CARGO_PKG_NAME")), $($class),+)
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __static_plugin {
    ($name:expr, $($class:ty),+) => {{
        $crate::__trocar_tables!($name, false, $($class),+);

        extern "C" fn entry() -> *const p::PluginTable {
            &raw const TABLE.0
        }
        $crate::StaticPlugin { manifest: p::manifest_text(&TEXT), entry }
    }};
}

/// Parts of both kinds of plugin: the rendered manifest and the tables.
#[doc(hidden)]
#[macro_export]
macro_rules! __trocar_tables {
    ($name:expr, $unload:literal, $($class:ty),+) => {
        #[cfg(panic = "abort")]
        compile_error!(
            "a trocar plugin is built with panic = \"unwind\": a panic must stop at the boundary, not end the host. \
             Remove `panic = \"abort\"` from the profile"
        );

        use $crate::__private as p;

        const CLASSES: &[&p::ClassDesc] = &[$(<$class as $crate::Class>::DESC),+];
        const NAME: &str = $name;
        const PLUGIN: p::PluginDesc = p::PluginDesc {
            name: NAME,
            version: env!("CARGO_PKG_VERSION"),
            vendor: env!("CARGO_PKG_AUTHORS"),
            license: env!("CARGO_PKG_LICENSE"),
            doc: env!("CARGO_PKG_DESCRIPTION"),
            built_with: p::BUILT_WITH,
            unload: $unload,
            classes: CLASSES,
        };
        const _: () = p::check_plugin(&PLUGIN);
        #[allow(long_running_const_eval)]
        const LEN: usize = p::render::<0>(&PLUGIN).1;
        #[allow(long_running_const_eval)]
        const TEXT: [u8; LEN] = p::render::<LEN>(&PLUGIN).0;

        static TABLES: p::Shared<[*const p::ClassTable; CLASSES.len()]> =
            p::Shared([$(p::Export::<$class>::TABLE),+]);

        static TABLE: p::Shared<p::PluginTable> = p::Shared(p::PluginTable {
            struct_size: ::core::mem::size_of::<p::PluginTable>() as u32,
            flags: 0,
            abi_major: p::ABI_MAJOR,
            abi_minor: p::ABI_MINOR,
            name: p::text(NAME),
            version: p::text(env!("CARGO_PKG_VERSION")),
            init: Some(p::init),
            class_count: CLASSES.len() as u32,
            reserved: 0,
            classes: &raw const TABLES.0 as *const *const p::ClassTable,
        });
    };
}

/// The second symbol, looked at by the vetting child only.
#[cfg(feature = "layout")]
#[doc(hidden)]
#[macro_export]
macro_rules! __trocar_layout {
    () => {
        $crate::__private::export_layout!();
    };
}

/// Without the feature `layout` there is no second symbol.
#[cfg(not(feature = "layout"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __trocar_layout {
    () => {};
}

/// `trocar-vision-filters` → `vision-filters`; other names stay.
pub const fn plugin_name(package: &'static str) -> &'static str {
    let (prefix, name) = ("trocar-".as_bytes(), package.as_bytes());
    if name.len() <= prefix.len() {
        return package;
    }
    let mut i = 0;
    while i < prefix.len() {
        if name[i] != prefix[i] {
            return package;
        }
        i += 1;
    }
    package.split_at(prefix.len()).1
}

/// A rendered manifest as text.
pub const fn manifest_text(rendered: &'static [u8]) -> &'static str {
    match core::str::from_utf8(rendered) {
        Ok(text) => text,
        Err(_) => panic!("the renderer copies text and adds ASCII"),
    }
}

/// The manifest's `built_with`.
pub const BUILT_WITH: &str = concat!("trocar-sdk ", env!("CARGO_PKG_VERSION"));
