//! Static descriptions that derives build and [`crate::render`] turns into the manifest at compile time.
//!
//! Invariant: everything here is const data without padding bytes of meaning; no allocation, no floats
//! (numbers of the author's attributes travel as their literal text).

/// A primitive of payloads. `Stamp` is a u64 of ns on the host's monotonic clock, 0 = invalid.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Prim {
    /// One byte, 0 or 1.
    Bool,
    /// Unsigned, 1 byte.
    U8,
    /// Signed, 1 byte.
    I8,
    /// Unsigned, 2 bytes.
    U16,
    /// Signed, 2 bytes.
    I16,
    /// Unsigned, 4 bytes.
    U32,
    /// Signed, 4 bytes.
    I32,
    /// Unsigned, 8 bytes.
    U64,
    /// Signed, 8 bytes.
    I64,
    /// Floating point, 4 bytes.
    F32,
    /// Floating point, 8 bytes.
    F64,
    /// A time, ns; 8 bytes.
    Stamp,
}

impl Prim {
    /// The word for it in a manifest.
    pub const fn name(self) -> &'static str {
        match self {
            Prim::Bool => "bool",
            Prim::U8 => "u8",
            Prim::I8 => "i8",
            Prim::U16 => "u16",
            Prim::I16 => "i16",
            Prim::U32 => "u32",
            Prim::I32 => "i32",
            Prim::U64 => "u64",
            Prim::I64 => "i64",
            Prim::F32 => "f32",
            Prim::F64 => "f64",
            Prim::Stamp => "stamp",
        }
    }

    /// Size and alignment in bytes.
    pub const fn size(self) -> usize {
        match self {
            Prim::Bool | Prim::U8 | Prim::I8 => 1,
            Prim::U16 | Prim::I16 => 2,
            Prim::U32 | Prim::I32 | Prim::F32 => 4,
            Prim::U64 | Prim::I64 | Prim::F64 | Prim::Stamp => 8,
        }
    }
}

/// A payload type. Plain old data without padding.
pub struct TypeDesc {
    /// Bytes of a value.
    pub size: usize,
    /// Alignment, bytes.
    pub align: usize,
    /// Its content.
    pub kind: TypeKind,
}

/// Content of a payload type.
pub enum TypeKind {
    /// A number, flag or stamp.
    Prim(Prim),
    /// `n` items, one after the other.
    Array {
        /// Type of an item.
        item: &'static TypeDesc,
        /// Number of items.
        n: usize,
    },
    /// A u64 length, then room for `n` items; the unused tail is zero.
    List {
        /// Type of an item.
        item: &'static TypeDesc,
        /// Most items.
        n: usize,
    },
    /// A u64 length in bytes, then room for `n` bytes of UTF-8; the unused tail is zero.
    Text {
        /// Most bytes.
        n: usize,
    },
    /// An integer newtype with named values.
    Enum {
        /// Name of the type.
        name: &'static str,
        /// The integer behind it.
        repr: Prim,
        /// Names and their numbers.
        values: &'static [(&'static str, i64)],
    },
    /// Fields one after the other, without padding.
    Struct {
        /// Name of the type.
        name: &'static str,
        /// Documentation; empty = none.
        doc: &'static str,
        /// Fields in the order of memory.
        fields: &'static [FieldDesc],
    },
}

impl TypeDesc {
    /// The type of a primitive; its alignment is its size.
    pub const fn prim(p: Prim) -> TypeDesc {
        TypeDesc { size: p.size(), align: p.size(), kind: TypeKind::Prim(p) }
    }

    /// Tells whether a port of this type may name its coordinate frame: some field holds coordinates (an
    /// array of floating point numbers, or a struct with one) and names no frame of its own.
    pub const fn takes_frame(&self) -> bool {
        match &self.kind {
            TypeKind::Array { item, .. } | TypeKind::List { item, .. } => item.takes_frame(),
            TypeKind::Struct { fields, .. } => {
                let mut i = 0;
                while i < fields.len() {
                    let f = &fields[i];
                    if f.frame.is_empty() && (f.ty.is_vector() || f.ty.takes_frame()) {
                        return true;
                    }
                    i += 1;
                }
                false
            }
            TypeKind::Prim(_) | TypeKind::Text { .. } | TypeKind::Enum { .. } => false,
        }
    }

    /// Tells whether a value of this type holds numbers, so that limits can apply to it. Flags, stamps, texts
    /// and named values are no numbers.
    pub const fn has_numbers(&self) -> bool {
        match &self.kind {
            TypeKind::Prim(p) => !matches!(p, Prim::Bool | Prim::Stamp),
            TypeKind::Array { item, .. } | TypeKind::List { item, .. } => item.has_numbers(),
            TypeKind::Struct { fields, .. } => {
                let mut i = 0;
                while i < fields.len() {
                    if fields[i].ty.has_numbers() {
                        return true;
                    }
                    i += 1;
                }
                false
            }
            TypeKind::Text { .. } | TypeKind::Enum { .. } => false,
        }
    }

    const fn is_vector(&self) -> bool {
        match &self.kind {
            TypeKind::Array { item, .. } => match &item.kind {
                TypeKind::Prim(Prim::F32 | Prim::F64) => true,
                _ => item.is_vector(),
            },
            _ => false,
        }
    }
}

/// One field of a struct. Empty `unit` = none; `frame` is a coordinate-frame tag.
pub struct FieldDesc {
    /// Name of the field.
    pub name: &'static str,
    /// Offset in its struct, bytes.
    pub at: usize,
    /// Type of the field.
    pub ty: &'static TypeDesc,
    /// Unit of its numbers.
    pub unit: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Coordinate frame of its coordinates, empty = not said.
    pub frame: &'static str,
}

/// Type of the data that flows through an input or output.
#[derive(Clone, Copy)]
pub enum PortType {
    /// Plain samples, copied.
    Plain(&'static TypeDesc),
    /// A plain header and bytes. `format` names how the bytes are read (e.g. "image", "spectra").
    Frame {
        /// Type of the header.
        header: &'static TypeDesc,
        /// Name of the way the bytes are read.
        format: &'static str,
        /// Bytes of the largest frame; 0 = reserved at Configure.
        max_bytes: usize,
    },
    /// Takes the type of what it is connected to.
    Any,
}

/// An input.
pub struct InputDesc {
    /// Name of the port.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Type of its samples.
    pub ty: PortType,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    /// "" or "sim": takes only outputs with the same tag; enforced at Connect.
    pub tag: &'static str,
    /// The component starts without a connection of it.
    pub optional: bool,
    /// Depth of the input's queue in samples; 0 = latest value only.
    pub fifo: usize,
}

/// An output.
pub struct OutputDesc {
    /// Name of the port.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Type of its samples.
    pub ty: PortType,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    /// "", "truth" or "sim", enforced at Connect.
    pub tag: &'static str,
}

/// Kind of a command: whether it takes, gives, waits, and where it runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CommandKind {
    /// Takes and gives nothing; queued for the component.
    Void,
    /// Takes an argument; queued for the component.
    Write,
    /// Gives a value, read from the last published state row.
    Read,
    /// As a read, with an argument.
    QualifiedRead,
    /// Gives a result once it has run in the component.
    VoidReturn,
    /// Takes an argument, and gives a result once it has run in the component.
    WriteReturn,
}

impl CommandKind {
    /// The word for it in a manifest.
    pub const fn name(self) -> &'static str {
        match self {
            CommandKind::Void => "void",
            CommandKind::Write => "write",
            CommandKind::Read => "read",
            CommandKind::QualifiedRead => "qualified_read",
            CommandKind::VoidReturn => "void_return",
            CommandKind::WriteReturn => "write_return",
        }
    }
}

/// An argument with its limits; `min` and `max` are JSON numbers as text, empty = none.
pub struct ArgDesc {
    /// Name of the argument; may be empty.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Type of the argument.
    pub ty: &'static TypeDesc,
    /// Unit of its numbers, empty = none.
    pub unit: &'static str,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    /// Lowest value.
    pub min: &'static str,
    /// Highest value.
    pub max: &'static str,
}

/// A command of a provided interface.
pub struct CommandDesc {
    /// Name of the command.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Kind of the command.
    pub kind: CommandKind,
    /// Its argument, where it takes one.
    pub arg: Option<ArgDesc>,
    /// Type of its result, where it gives one.
    pub ret: Option<&'static TypeDesc>,
    /// Unit of the returned value, empty = none.
    pub ret_unit: &'static str,
    /// Coordinate frame of the returned value, empty = not said.
    pub ret_frame: &'static str,
    /// Mailbox policy: "reject", "latest_wins", "drop_oldest".
    pub overflow: &'static str,
}

/// An event of a provided interface.
pub struct EventDesc {
    /// Name of the event.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Type of its payload, where it has one.
    pub payload: Option<&'static TypeDesc>,
    /// Unit of a payload that is a number, empty = none.
    pub unit: &'static str,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
}

/// A provided interface.
pub struct ProvidedDesc {
    /// Name of the interface.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// "", "truth" or "sim", enforced at Connect.
    pub tag: &'static str,
    /// Its commands, in the order of their ids.
    pub commands: &'static [CommandDesc],
    /// Its events, in the order of their ids.
    pub events: &'static [EventDesc],
}

/// A function of a required interface.
pub struct FunctionDesc {
    /// Name of the function, and of the command it is bound to.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Void when neither `arg` nor `ret`; a function with `ret` binds to reads and to returning commands
    /// alike.
    pub arg: Option<&'static TypeDesc>,
    /// Type of the result it needs.
    pub ret: Option<&'static TypeDesc>,
    /// Unit the argument must have, empty = not checked.
    pub unit: &'static str,
    /// Coordinate frame of argument and result, of whichever has coordinates; empty = not said.
    pub frame: &'static str,
    /// The interface may be connected to one without this command.
    pub optional: bool,
    /// Takes the type of the command it is connected to.
    pub any: bool,
}

/// A handler of a required interface.
pub struct HandlerDesc {
    /// Name of the handler, and of the event it hears.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Type of the payload, where it has one.
    pub payload: Option<&'static TypeDesc>,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    /// The interface may be connected to one without this event.
    pub optional: bool,
    /// Runs inside `emit` when both ends share an executor.
    pub direct: bool,
}

/// A required interface.
pub struct RequiredDesc {
    /// Name of the interface.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// The component starts without a connection of it.
    pub optional: bool,
    /// Its functions, in the order of their ids.
    pub functions: &'static [FunctionDesc],
    /// Its handlers, in the order of their ids.
    pub handlers: &'static [HandlerDesc],
}

/// One configuration field. `schema` is the inside of its JSON Schema object (`"type":"number"`), never
/// empty; `min`, `max`, `default` are JSON text, empty = none.
pub struct ConfigFieldDesc {
    /// Name of the field; a JSON key.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Inside of its JSON Schema object.
    pub schema: &'static str,
    /// Unit of its number, empty = none.
    pub unit: &'static str,
    /// Lowest value.
    pub min: &'static str,
    /// Highest value.
    pub max: &'static str,
    /// Value where the user gives none; empty = the user has to give one.
    pub default: &'static str,
    /// May be changed while the component runs.
    pub live: bool,
}

/// Effect of a class on the world.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Safety {
    /// Neither measures nor moves.
    None,
    /// Measures.
    Sensor,
    /// Moves something: it must have `make_safe`.
    Actuator,
}

impl Safety {
    /// The word for it in a manifest.
    pub const fn name(self) -> &'static str {
        match self {
            Safety::None => "none",
            Safety::Sensor => "sensor",
            Safety::Actuator => "actuator",
        }
    }
}

/// A component class.
pub struct ClassDesc {
    /// Name of the class, unique in its plugin.
    pub name: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Effect on the world.
    pub safety: Safety,
    /// Opens a device: never created in a vetting child, no shadow steps at a swap.
    pub hardware: bool,
    /// `make_safe` touches only what is made for several threads: it may be called while another entry hangs.
    pub safe_from_any_thread: bool,
    /// Starts programs: created only in a process that allows that.
    pub starts_programs: bool,
    /// Default execution model: "periodic", "continuous", "on_signal", "on_callback", "stream", "none".
    pub model: &'static str,
    /// Default period of a periodic or stream class, ns; 0 = none.
    pub period_ns: u64,
    /// Longest stay inside its own code, ns; 0 = the host's default.
    pub max_step_ns: u64,
    /// The executions its components can be run by.
    pub limits: ExecutionLimitsDesc,
    /// Fields of the configuration.
    pub config: &'static [ConfigFieldDesc],
    /// Its inputs, in the order of their slots.
    pub inputs: &'static [InputDesc],
    /// Its outputs, in the order of their slots.
    pub outputs: &'static [OutputDesc],
    /// Its required interfaces.
    pub required: &'static [RequiredDesc],
    /// Its provided interfaces.
    pub provided: &'static [ProvidedDesc],
    /// Type of a row of its state table, where it has one.
    pub state: Option<&'static TypeDesc>,
    /// Ports that exist once for each name of a list.
    pub many: ManyDesc,
}

/// The executions a class is made for; a component is never run by another.
pub struct ExecutionLimitsDesc {
    /// Execution models; empty = any.
    pub models: &'static [&'static str],
    /// Shortest time between two steps, ns; 0 = no limit.
    pub min_period_ns: u64,
    /// Longest time between two steps, ns; 0 = no limit.
    pub max_period_ns: u64,
}

impl ExecutionLimitsDesc {
    /// A class that runs right however it is run.
    pub const NONE: ExecutionLimitsDesc =
        ExecutionLimitsDesc { models: &[], min_period_ns: 0, max_period_ns: 0 };
}

/// Ports and interfaces that exist once for each name of a list which the component sets while it lives. In
/// their names, `{}` stands for that name.
pub struct ManyDesc {
    /// Inputs.
    pub inputs: &'static [InputDesc],
    /// Outputs.
    pub outputs: &'static [OutputDesc],
    /// Required interfaces.
    pub required: &'static [RequiredDesc],
    /// Provided interfaces.
    pub provided: &'static [ProvidedDesc],
}

impl ManyDesc {
    /// A class whose ports are all fixed.
    pub const NONE: ManyDesc = ManyDesc { inputs: &[], outputs: &[], required: &[], provided: &[] };

    /// Tells whether the class has no such ports.
    pub const fn is_empty(&self) -> bool {
        self.inputs.is_empty()
            && self.outputs.is_empty()
            && self.required.is_empty()
            && self.provided.is_empty()
    }
}

/// A plugin: what its manifest says before its classes.
pub struct PluginDesc {
    /// Name: letters, digits, `_`, `-`.
    pub name: &'static str,
    /// Version, shown; the same as in the entry's table.
    pub version: &'static str,
    /// Maker, shown; empty = not said.
    pub vendor: &'static str,
    /// Licence, shown; empty = not said.
    pub license: &'static str,
    /// Documentation; empty = none.
    pub doc: &'static str,
    /// Compiler and SDK, shown; empty = not said.
    pub built_with: &'static str,
    /// The library may leave the process when nothing of it is used any more.
    pub unload: bool,
    /// Its classes, in the order of the entry's table.
    pub classes: &'static [&'static ClassDesc],
}
