//! The standard payloads by name, field by field: the content of `trocar_sdk::data`, as data for checks and
//! documents.
//!
//! Invariant: the same as the structs of the SDK; a test of the SDK compares each, names, types, units and
//! documentation.

/// A standard payload: a struct with fields, or an integer with named values.
#[derive(Debug)]
pub struct Payload {
    /// Name of the struct or enum, as manifests have it.
    pub name: &'static str,
    /// Its documentation, as in the SDK.
    pub doc: &'static str,
    /// Fields in the order of memory; empty for named values.
    pub fields: &'static [PayloadField],
    /// The integer behind named values; empty for a struct.
    pub repr: &'static str,
    /// Names and their numbers; empty for a struct.
    pub values: &'static [(&'static str, i64)],
}

/// One field of a payload.
#[derive(Debug)]
pub struct PayloadField {
    /// Name of the field.
    pub name: &'static str,
    /// As in [`super::Carries`].
    pub ty: &'static str,
    /// Unit, SI; `a|b` where it is one of two; empty = none.
    pub unit: &'static str,
    /// Documentation of the field; empty = none.
    pub doc: &'static str,
}

/// The payload of this name.
pub(super) fn payload(name: &str) -> Option<&'static Payload> {
    PAYLOADS.iter().find(|p| p.name == name)
}

const fn f(name: &'static str, ty: &'static str, unit: &'static str, doc: &'static str) -> PayloadField {
    PayloadField { name, ty, unit, doc }
}

/// All standard payloads.
pub const PAYLOADS: &[Payload] = &[
    Payload {
        name: "JointState",
        doc: "Joint vectors of a robot (CRTK `measured_js`, `setpoint_js`). Prismatic joints in m, revolute ones in rad; the interface's `configuration_js` says which is which.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("position", "list[f64;16]", "m|rad", ""),
            f("velocity", "list[f64;16]", "m/s|rad/s", ""),
            f("effort", "list[f64;16]", "N|N.m", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "JointConfiguration",
        doc: "Names, kinds and limits of the joints (CRTK `configuration_js`), one item per joint in each list.",
        fields: &[
            f("stamp", "stamp", "", "When these limits began to hold."),
            f("names", "list[text[16];16]", "", ""),
            f("kinds", "list[JointKind;16]", "", ""),
            f("lower", "list[f64;16]", "m|rad", ""),
            f("upper", "list[f64;16]", "m|rad", ""),
            f("speed", "list[f64;16]", "m/s|rad/s", "Highest speed, to both sides."),
            f(
                "acceleration",
                "list[f64;16]",
                "m/s^2|rad/s^2",
                "Highest acceleration, to both sides; empty where it is not limited.",
            ),
            f(
                "effort",
                "list[f64;16]",
                "N|N.m",
                "Highest force or torque, to both sides; empty where it is not limited.",
            ),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "JointKind",
        doc: "What a joint does; decides the unit of its values.",
        fields: &[],
        repr: "u32",
        values: &[("PRISMATIC", 1), ("REVOLUTE", 2)],
    },
    Payload {
        name: "Pose",
        doc: "A position and orientation (CRTK `measured_cp`), in the frame that the interface says.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("position", "[f64;3]", "m", ""),
            f("orientation", "[f64;4]", "", "Unit quaternion x, y, z, w."),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "Twist",
        doc: "Linear and angular velocity (CRTK `measured_cv`).",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("linear", "[f64;3]", "m/s", ""),
            f("angular", "[f64;3]", "rad/s", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "Wrench",
        doc: "Force and torque (CRTK `measured_cf`).",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("force", "[f64;3]", "N", ""),
            f("torque", "[f64;3]", "N.m", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "CartesianState",
        doc: "Pose, twist and wrench of one instant (`measured_cs`). A part that is not measured keeps stamp 0.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("pose", "Pose", "", ""),
            f("twist", "Twist", "", ""),
            f("wrench", "Wrench", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "ArmState",
        doc: "One sample of an arm's stream: joints, tip and wrench of the same instant, so they carry the same stamp; a wrench \
              that is not measured has stamp 0.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("measured_js", "JointState", "", ""),
            f("measured_cp", "Pose", "", ""),
            f(
                "measured_cf",
                "Wrench",
                "",
                "As the read `measured_cf` of the arm: what the tip meets; stamp 0 where nothing measures it.",
            ),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "OperatingState",
        doc: "CRTK `operating_state`.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("state", "OperatingMode", "", ""),
            f("is_homed", "bool", "", ""),
            f("is_busy", "bool", "", ""),
            f("reserved", "[u8;2]", "", ""),
            f("message", "text[128]", "", "Why, in one sentence."),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "OperatingMode",
        doc: "CRTK operating states.",
        fields: &[],
        repr: "u32",
        values: &[("DISABLED", 0), ("ENABLED", 1), ("PAUSED", 2), ("FAULT", 3)],
    },
    Payload {
        name: "Transform",
        doc: "A rigid transform between two named frames: takes coordinates in `child` to coordinates in `parent`.",
        fields: &[f("pose", "Pose", "", ""), f("parent", "text[32]", "", ""), f("child", "text[32]", "", "")],
        repr: "",
        values: &[],
    },
    Payload {
        name: "CameraGeometry",
        doc: "Size and rate of a camera (`camera_geometry`).",
        fields: &[
            f("width", "u32", "px", "Of one image."),
            f("height", "u32", "px", ""),
            f("fps", "f64", "Hz", "Images or pairs per second; 0 before the first one."),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "ImageHeader",
        doc: "Header of an image frame.",
        fields: &[
            f("stamp", "stamp", "", "When the image was taken."),
            f("index", "u64", "", "Counts the source's images, from 0."),
            f("width", "u32", "px", ""),
            f("height", "u32", "px", ""),
            f("stride", "u32", "B", "From one row to the next."),
            f("format", "PixelFormat", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "StereoHeader",
        doc: "Header of a stereo pair: two images of one size and format in one frame.",
        fields: &[
            f("stamp", "stamp", "", "When the pair was taken."),
            f("index", "u64", "", "Counts the source's pairs, from 0."),
            f("width", "u32", "px", "Of one image."),
            f("height", "u32", "px", ""),
            f("stride", "u32", "B", "From one row to the next."),
            f("format", "PixelFormat", "", ""),
            f("right_offset", "u64", "B", "Where the right image begins; the left one begins at 0."),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "PixelFormat",
        doc: "Pixel formats; rows are `stride` bytes apart.",
        fields: &[],
        repr: "u32",
        values: &[
            ("GRAY8", 1),
            ("RGB8", 2),
            ("BGR8", 3),
            ("RGBA8", 4),
            ("GRAY16", 5),
            ("BAYER_RG8", 6),
            ("YUYV", 7),
            ("DISPARITY16", 8),
            ("DEPTH32F", 9),
        ],
    },
    Payload {
        name: "Spectrometer",
        doc: "A spectrometer (`spectrometer`): which light falls on which pixel. Wavelength of pixel i of n, with x = 2 i / (n - 1) - 1, is the sum of `wavelength[k]` times x to the power k.",
        fields: &[
            f("samples", "u32", "px", "Pixels of one line."),
            f("bits", "u32", "", "Bits of a value that the detector fills."),
            f("wavelength", "[f64;4]", "m", "Polynomial over the line, x from -1 to 1."),
            f("line_rate", "f64", "Hz", ""),
            f("exposure", "f64", "s", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "SpectraHeader",
        doc: "Header of a frame of raw spectra: `lines` exposures one after the other, each of `samples` pixels of the detector.",
        fields: &[
            f("stamp", "stamp", "", "Middle of the first line's exposure."),
            f("index", "u64", "", "Counts the source's lines, from 0; that of the first line here."),
            f("lines", "u32", "", "Exposures in this frame."),
            f("samples", "u32", "px", "Pixels of one line."),
            f("format", "SampleFormat", "", ""),
            f("bits", "u32", "", "Bits of a value that the detector fills, at most those of the format."),
            f("line_period", "f64", "s", "From the middle of one exposure to that of the next."),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "AScanHeader",
        doc: "Header of a frame of A-scans: `lines` depth profiles one after the other, each of `samples` bins, in dB for `F32`.",
        fields: &[
            f("stamp", "stamp", "", "That of the spectra it was made of."),
            f("index", "u64", "", "That of the spectra it was made of."),
            f("lines", "u32", "", "Depth profiles in this frame."),
            f("samples", "u32", "px", "Bins of one profile."),
            f("format", "SampleFormat", "", ""),
            f("reserved", "u32", "", ""),
            f("line_period", "f64", "s", "From one line to the next."),
            f("bin", "f64", "m", "Optical path from one bin to the next: depth times index of refraction."),
            f("first", "f64", "m", "Optical path of the first bin."),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "SampleFormat",
        doc: "What one value of a line is.",
        fields: &[],
        repr: "u32",
        values: &[("U16", 1), ("F32", 2), ("U8", 3)],
    },
    Payload {
        name: "Distance",
        doc: "A distance from the tip of a tool to a surface, along the tool.",
        fields: &[
            f("stamp", "stamp", "", "When it was so: the middle of the exposure."),
            f("distance", "f64", "m", ""),
            f(
                "velocity",
                "f64",
                "m/s",
                "Velocity of the surface along the tool against the base, away from the tip positive; NaN: not known.",
            ),
            f("sigma", "f64", "m", "Standard deviation of `distance`."),
            f("snr_db", "f64", "", "The surface's echo above the noise, dB; 0 without one."),
            f(
                "valid",
                "bool",
                "",
                "False: there was no surface to be seen, and the rest is at best a prediction.",
            ),
            f("reserved", "[u8;7]", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "TrackedTools",
        doc: "All tools of one measurement.",
        fields: &[
            f("stamp", "stamp", "", "When the tracker measured."),
            f("index", "u64", "", "Counts the tracker's measurements, from 0."),
            f("tools", "list[ToolPose;8]", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "ToolPose",
        doc: "One tool as a tracker sees it.",
        fields: &[
            f("tool", "text[16]", "", "The tool's name, as configured."),
            f("pose", "Pose", "", "In the tracker's own frame; stamp 0 when the tool is not in view."),
            f("error", "f64", "m", "Root mean square distance of the markers from where the pose puts them."),
            f("status", "ToolStatus", "", ""),
            f("reserved", "u32", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "ToolStatus",
        doc: "What a tracker knows of a tool.",
        fields: &[],
        repr: "u32",
        values: &[("MISSING", 0), ("TRACKED", 1), ("PARTLY_HIDDEN", 2), ("AT_BORDER", 3)],
    },
    Payload {
        name: "ForceRange",
        doc: "What a force sensor can measure (`range`), each component to both sides; 0 = does not measure it.",
        fields: &[
            f("force", "[f64;3]", "N", ""),
            f("torque", "[f64;3]", "N.m", ""),
            f("force_noise", "f64", "N", "Standard deviation of one sample's force."),
            f("torque_noise", "f64", "N.m", "Standard deviation of one sample's torque."),
            f("rate", "f64", "Hz", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "InputState",
        doc: "Axes and buttons of an input device: pedal, joystick, gamepad.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("axes", "list[f64;16]", "", "-1 to 1, a pedal 0 to 1; 0 at rest."),
            f("buttons", "list[bool;32]", "", "True while pressed."),
            f(
                "connected",
                "bool",
                "",
                "The device answers; when it does not, every axis is 0 and no button is pressed.",
            ),
            f("reserved", "[u8;7]", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "InputLayout",
        doc: "Names of an input device's axes and buttons, in the order of `InputState`.",
        fields: &[f("axes", "list[text[16];16]", "", ""), f("buttons", "list[text[16];32]", "", "")],
        repr: "",
        values: &[],
    },
    Payload {
        name: "ButtonEvent",
        doc: "A button of an input device changed.",
        fields: &[
            f("stamp", "stamp", "", ""),
            f("button", "u32", "", "Position in `InputState::buttons`."),
            f("pressed", "bool", "", ""),
            f("reserved", "[u8;3]", "", ""),
        ],
        repr: "",
        values: &[],
    },
    Payload {
        name: "Scalar",
        doc: "One number with its time: the simplest signal.",
        fields: &[f("stamp", "stamp", "", ""), f("value", "f64", "", "")],
        repr: "",
        values: &[],
    },
    Payload {
        name: "Message",
        doc: "A line for people.",
        fields: &[f("stamp", "stamp", "", ""), f("text", "text[240]", "", "")],
        repr: "",
        values: &[],
    },
];
