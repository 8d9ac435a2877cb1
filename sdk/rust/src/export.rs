//! `trocar_plugin!`: the manifest note, the tables and the one exported symbol.
//!
//! Invariant: everything the macro emits is const data, so a host can read the manifest without running a byte.

/// Exports component classes as a plugin: `trocar_plugin!(LowPass, Notch);`, once per `cdylib` crate.
///
/// The plugin's name is the crate's without a leading `trocar-`; version, licence and description are the crate's.
/// `trocar_plugin!(LowPass; unload)` says that the library may be unmapped when no instance is left: it starts no
/// threads and leaves nothing behind.
#[macro_export]
macro_rules! trocar_plugin {
    ($($class:ty),+ $(,)?) => { $crate::__trocar_plugin!(false, $($class),+); };
    ($($class:ty),+ ; unload) => { $crate::__trocar_plugin!(true, $($class),+); };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __trocar_plugin {
    ($unload:literal, $($class:ty),+) => {
        #[cfg(panic = "abort")]
        compile_error!(
            "a trocar plugin is built with panic = \"unwind\": a panic must stop at the boundary, not end the host. \
             Remove `panic = \"abort\"` from the profile"
        );

        #[allow(long_running_const_eval)]
        const _: () = {
            use $crate::__private as p;

            const CLASSES: &[&p::ClassDesc] = &[$(<$class as $crate::Class>::DESC),+];
            const NAME: &str = p::plugin_name(env!("CARGO_PKG_NAME"));
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
            const LEN: usize = p::render::<0>(&PLUGIN).1;

            #[used]
            #[unsafe(link_section = ".note.trocar")]
            static NOTE: p::Note<LEN> = p::Note::new(p::render::<LEN>(&PLUGIN).0);

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

            $crate::__trocar_layout!();

            #[unsafe(no_mangle)]
            extern "C" fn trocar_plugin_v1() -> *const p::PluginTable {
                &raw const TABLE.0
            }
        };
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

/// The manifest's `built_with`.
pub const BUILT_WITH: &str = concat!("trocar-sdk ", env!("CARGO_PKG_VERSION"));
