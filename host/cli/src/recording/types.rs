//! The types that a file describes, made once for all channels of one description.
//!
//! Invariant: the cost of a description is bounded before it is made: its parts may be two bytes each.

use std::collections::BTreeMap;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, MessageDescriptor};
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};

use super::read::Schema;

/// Largest description, B.
const LARGEST: usize = 512 << 10;
/// Types, fields and values of enums that all descriptions of a file may have.
const MOST: usize = 1 << 17;
/// Longest name in a description, B.
const NAME: usize = 512;

/// The types that the file has described so far.
#[derive(Default)]
pub(super) struct Types {
    /// By the number of the description.
    pools: BTreeMap<usize, Result<DescriptorPool, String>>,
    parts: usize,
}

impl Types {
    /// The type that a description is of.
    ///
    /// # Errors
    /// The reason why there is none, as a sentence.
    pub(super) fn message(&mut self, schema: &Schema) -> Result<MessageDescriptor, String> {
        if !self.pools.contains_key(&schema.number) {
            let pool = self.pool(&schema.data);
            self.pools.insert(schema.number, pool);
        }
        let pool = self.pools.get(&schema.number).and_then(|pool| pool.as_ref().ok());
        let wrong = || match self.pools.get(&schema.number) {
            Some(Err(wrong)) => wrong.clone(),
            _ => "its description has no such type".to_owned(),
        };
        let message = pool.and_then(|pool| pool.get_message_by_name(&schema.name));
        message.ok_or_else(|| format!("type {:?}: {}", super::shown(&schema.name), wrong()))
    }

    fn pool(&mut self, data: &[u8]) -> Result<DescriptorPool, String> {
        if data.len() > LARGEST {
            return Err(format!("its description of {} B is over the limit of {LARGEST} B", data.len()));
        }
        let set = FileDescriptorSet::decode(data).map_err(|_| "its description is damaged".to_owned())?;
        self.parts += parts(&set)?;
        if self.parts > MOST {
            return Err(format!("the file describes more than {MOST} types, fields and values"));
        }
        // The library panics over some damaged descriptions: they describe nothing, either.
        let made = unless_it_panics(|| DescriptorPool::from_file_descriptor_set(set).ok()).flatten();
        made.ok_or_else(|| "its description contradicts itself".to_owned())
    }
}

/// The number of parts of a description.
fn parts(set: &FileDescriptorSet) -> Result<usize, String> {
    let mut count = 0;
    for file in &set.file {
        name(file.package.as_ref())?;
        file.message_type.iter().try_for_each(|message| message_parts(message, &mut count))?;
        file.enum_type.iter().try_for_each(|of| enum_parts(of, &mut count))?;
        count += 1 + file.service.len() + file.extension.len() + file.dependency.len();
    }
    Ok(count)
}

/// No deeper than protobuf is decoded, 100 levels.
fn message_parts(message: &DescriptorProto, count: &mut usize) -> Result<(), String> {
    name(message.name.as_ref())?;
    message.field.iter().try_for_each(|field| name(field.name.as_ref()))?;
    message.nested_type.iter().try_for_each(|inner| message_parts(inner, count))?;
    message.enum_type.iter().try_for_each(|of| enum_parts(of, count))?;
    *count += 1 + message.field.len() + message.oneof_decl.len() + message.extension.len();
    Ok(())
}

fn enum_parts(of: &EnumDescriptorProto, count: &mut usize) -> Result<(), String> {
    name(of.name.as_ref())?;
    *count += 1 + of.value.len();
    of.value.iter().try_for_each(|value| name(value.name.as_ref()))
}

fn name(name: Option<&String>) -> Result<(), String> {
    match name.map_or(0, String::len) {
        len if len > NAME => {
            Err(format!("its description has a name of {len} B, over the limit of {NAME} B"))
        }
        _ => Ok(()),
    }
}

/// Returns what `f` gives, or nothing where it panics. Nothing of a panic is printed.
pub(super) fn unless_it_panics<T>(f: impl FnOnce() -> T) -> Option<T> {
    thread_local! {
        static QUIET: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
    }
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let told = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !QUIET.get() {
                told(info);
            }
        }));
    });
    let before = QUIET.replace(true);
    // After a panic nothing that `f` changed is looked at.
    let given = panic::catch_unwind(AssertUnwindSafe(f));
    QUIET.set(before);
    given.ok()
}
