//! Static descriptions that derives build and [`crate::render`] turns into the manifest at compile time.
//!
//! Invariant: everything here is const data without padding bytes of meaning; no allocation, no floats
//! (numbers of the author's attributes travel as their literal text).

/// A primitive of payloads. `Stamp` is a u64 of ns on the host's monotonic clock, 0 = invalid.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Prim {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
    Stamp,
}

impl Prim {
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
    pub size: usize,
    pub align: usize,
    pub kind: TypeKind,
}

pub enum TypeKind {
    Prim(Prim),
    Array {
        item: &'static TypeDesc,
        n: usize,
    },
    /// A u64 length, then room for `n` items; the unused tail is zero.
    List {
        item: &'static TypeDesc,
        n: usize,
    },
    /// A u64 length in bytes, then room for `n` bytes of UTF-8; the unused tail is zero.
    Text {
        n: usize,
    },
    /// An integer newtype with named values.
    Enum {
        name: &'static str,
        repr: Prim,
        values: &'static [(&'static str, i64)],
    },
    Struct {
        name: &'static str,
        doc: &'static str,
        fields: &'static [FieldDesc],
    },
}

impl TypeDesc {
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
    pub name: &'static str,
    pub at: usize,
    pub ty: &'static TypeDesc,
    pub unit: &'static str,
    pub doc: &'static str,
    pub frame: &'static str,
}

/// Type of the data that flows through an input or output.
#[derive(Clone, Copy)]
pub enum PortType {
    Plain(&'static TypeDesc),
    /// A plain header and bytes. `format` names how the bytes are read (e.g. "image", "spectra").
    Frame {
        header: &'static TypeDesc,
        format: &'static str,
        max_bytes: usize,
    },
    /// Takes the type of what it is connected to.
    Any,
}

pub struct InputDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub ty: PortType,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    /// "" or "sim": takes only outputs with the same tag; enforced at Connect.
    pub tag: &'static str,
    pub optional: bool,
    /// Depth of the input's queue in samples; 0 = latest value only.
    pub fifo: usize,
}

pub struct OutputDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub ty: PortType,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    /// "", "truth" or "sim", enforced at Connect.
    pub tag: &'static str,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CommandKind {
    Void,
    Write,
    Read,
    QualifiedRead,
    VoidReturn,
    WriteReturn,
}

impl CommandKind {
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
    pub name: &'static str,
    pub doc: &'static str,
    pub ty: &'static TypeDesc,
    pub unit: &'static str,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    pub min: &'static str,
    pub max: &'static str,
}

pub struct CommandDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub kind: CommandKind,
    pub arg: Option<ArgDesc>,
    pub ret: Option<&'static TypeDesc>,
    /// Unit of the returned value, empty = none.
    pub ret_unit: &'static str,
    /// Coordinate frame of the returned value, empty = not said.
    pub ret_frame: &'static str,
    /// Mailbox policy: "reject", "latest_wins", "drop_oldest".
    pub overflow: &'static str,
}

pub struct EventDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub payload: Option<&'static TypeDesc>,
    pub unit: &'static str,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
}

pub struct ProvidedDesc {
    pub name: &'static str,
    pub doc: &'static str,
    /// "", "truth" or "sim", enforced at Connect.
    pub tag: &'static str,
    pub commands: &'static [CommandDesc],
    pub events: &'static [EventDesc],
}

pub struct FunctionDesc {
    pub name: &'static str,
    pub doc: &'static str,
    /// Void when neither `arg` nor `ret`; a function with `ret` binds to reads and to returning commands
    /// alike.
    pub arg: Option<&'static TypeDesc>,
    pub ret: Option<&'static TypeDesc>,
    /// Unit the argument must have, empty = not checked.
    pub unit: &'static str,
    /// Coordinate frame of argument and result, of whichever has coordinates; empty = not said.
    pub frame: &'static str,
    pub optional: bool,
    /// Takes the type of the command it is connected to.
    pub any: bool,
}

pub struct HandlerDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub payload: Option<&'static TypeDesc>,
    /// Coordinate frame of the payload, empty = not said.
    pub frame: &'static str,
    pub optional: bool,
    /// Runs inside `emit` when both ends share an executor.
    pub direct: bool,
}

pub struct RequiredDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub optional: bool,
    pub functions: &'static [FunctionDesc],
    pub handlers: &'static [HandlerDesc],
}

/// One configuration field. `schema` is the inside of its JSON Schema object (`"type":"number"`), never
/// empty; `min`, `max`, `default` are JSON text, empty = none.
pub struct ConfigFieldDesc {
    pub name: &'static str,
    pub doc: &'static str,
    pub schema: &'static str,
    pub unit: &'static str,
    pub min: &'static str,
    pub max: &'static str,
    pub default: &'static str,
    pub live: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Safety {
    None,
    Sensor,
    Actuator,
}

impl Safety {
    pub const fn name(self) -> &'static str {
        match self {
            Safety::None => "none",
            Safety::Sensor => "sensor",
            Safety::Actuator => "actuator",
        }
    }
}

pub struct ClassDesc {
    pub name: &'static str,
    pub doc: &'static str,
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
    pub config: &'static [ConfigFieldDesc],
    pub inputs: &'static [InputDesc],
    pub outputs: &'static [OutputDesc],
    pub required: &'static [RequiredDesc],
    pub provided: &'static [ProvidedDesc],
    pub state: Option<&'static TypeDesc>,
    pub many: ManyDesc,
}

/// The executions a class is made for; a component is never run by another.
pub struct ExecutionLimitsDesc {
    /// Execution models; empty = any.
    pub models: &'static [&'static str],
    /// Shortest and longest time between two steps, ns; 0 = no limit.
    pub min_period_ns: u64,
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
    pub inputs: &'static [InputDesc],
    pub outputs: &'static [OutputDesc],
    pub required: &'static [RequiredDesc],
    pub provided: &'static [ProvidedDesc],
}

impl ManyDesc {
    /// A class whose ports are all fixed.
    pub const NONE: ManyDesc = ManyDesc { inputs: &[], outputs: &[], required: &[], provided: &[] };

    pub const fn is_empty(&self) -> bool {
        self.inputs.is_empty()
            && self.outputs.is_empty()
            && self.required.is_empty()
            && self.provided.is_empty()
    }
}

pub struct PluginDesc {
    pub name: &'static str,
    pub version: &'static str,
    pub vendor: &'static str,
    pub license: &'static str,
    pub doc: &'static str,
    pub built_with: &'static str,
    pub unload: bool,
    pub classes: &'static [&'static ClassDesc],
}
