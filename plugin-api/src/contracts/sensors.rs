//! The contracts of devices that measure: camera, spectrometer, tracker, force sensor, input device.
//!
//! Invariant: each counts its samples from 0 and tells what it lost; a sample carries the time of its
//! measurement.

use super::{Carries, Command, Contract, Flows, Interface, Output, event, read, void};

const ONE_THREAD: &str = "Reads are answered from the row of the last step, in the caller's thread, and never wait. Samples \
                          leave in `step`, or in a callback of the device's own thread; a slow reader never holds them up.";

/// A camera, one image or a stereo pair at a time.
pub const CAMERA: Contract = Contract {
    name: "camera",
    doc: "A camera: images or stereo pairs in pooled memory, handed on without a copy.",
    safety: "sensor",
    frames: "Pixel (0, 0) is the top left corner; x goes right, y down. The stamp is the time of the exposure, not of the \
             delivery. `index` counts what the camera took, from 0.",
    threads: ONE_THREAD,
    rules: &[
        "An image that cannot be sent because readers hold all frames is left out, its `index` is used up, and \
         `frame_dropped` tells how many were left out since Start.",
        "Width, height and format stay the same from Start to Stop and are those of `camera_geometry`.",
        "Rows are `stride` bytes apart; what the header says lies in the frame's bytes.",
    ],
    tried_by: "assert_behaves_as_camera",
    interfaces: &[Interface {
        name: "camera",
        doc: "What the camera sees and sent.",
        required: true,
        commands: &[
            read("camera_geometry", true, "CameraGeometry", "Size and rate of the images."),
            read("emitted", false, "u64", "Images sent since Start."),
        ],
        events: &[event("frame_dropped", true, "u64", "Images left out since Start.")],
    }],
    outputs: &[Output {
        name: "image",
        doc: "The images.",
        required: true,
        one_of: &[
            Flows::Frames { header: "ImageHeader", format: "image" },
            Flows::Frames { header: "StereoHeader", format: "stereo" },
        ],
    }],
};

/// A spectrometer of optical coherence tomography.
pub const SPECTROMETER: Contract = Contract {
    name: "spectrometer",
    doc: "A spectrometer of optical coherence tomography: raw spectra, many lines in one frame.",
    safety: "sensor",
    frames: "A line goes from pixel 0 to `samples` - 1; `spectrometer` says which wavelength falls on which. The stamp is the \
             middle of the first line's exposure, later ones follow in steps of `line_period`.",
    threads: ONE_THREAD,
    rules: &[
        "`index` counts lines, so a gap between two frames is exactly what was lost.",
        "Lines the detector took and nobody fetched in time are told by `overrun`, as their number since Start.",
        "Values are what the detector counted: no background is subtracted, nothing is resampled.",
    ],
    tried_by: "",
    interfaces: &[Interface {
        name: "spectrometer",
        doc: "The detector.",
        required: true,
        commands: &[
            read(
                "spectrometer",
                true,
                "Spectrometer",
                "Which light falls on which pixel, how often, for how long.",
            ),
            void("trigger", false, "Take one frame now; only where the configuration asks for triggers."),
        ],
        events: &[event("overrun", true, "u64", "Lines lost since Start.")],
    }],
    outputs: &[Output {
        name: "spectra",
        doc: "Raw spectra.",
        required: true,
        one_of: &[Flows::Frames { header: "SpectraHeader", format: "spectra" }],
    }],
};

/// A position tracker.
pub const TRACKER: Contract = Contract {
    name: "tracker",
    doc: "A tracker of tools in space, optical or electromagnetic.",
    safety: "sensor",
    frames: "Poses are in the tracker's own frame: a registration brings them to another. All tools of one sample were \
             measured at its stamp; a tool that is not in view keeps its place in the list with a pose of stamp 0.",
    threads: ONE_THREAD,
    rules: &[
        "The list holds every configured tool, always in the configured order.",
        "An old pose is never given for a tool that is not in view.",
        "`tool_lost` and `tool_found` come once for each change.",
    ],
    tried_by: "",
    interfaces: &[Interface {
        name: "tracker",
        doc: "The tools.",
        required: true,
        commands: &[
            read("tools", true, "TrackedTools", "All tools as measured last."),
            Command {
                name: "pose_of",
                doc: "Pose of one tool by its name; refused for a name that is not configured.",
                required: false,
                kind: "qualified_read",
                arg: Carries::of("text[16]"),
                ret: Carries::of("Pose"),
                overflow: "",
            },
        ],
        events: &[
            event("tool_lost", true, "text[16]", "This tool is no longer in view."),
            event("tool_found", true, "text[16]", "This tool is in view again."),
        ],
    }],
    outputs: &[Output {
        name: "tools",
        doc: "Each measurement.",
        required: true,
        one_of: &[Flows::Samples("TrackedTools")],
    }],
};

/// A force or force-torque sensor.
pub const FORCE_SENSOR: Contract = Contract {
    name: "force_sensor",
    doc: "A force or force-torque sensor.",
    safety: "sensor",
    frames: "In the sensor's own frame; positive is what the world does to the sensor. Components it does not measure are 0, \
             and 0 in `range`.",
    threads: ONE_THREAD,
    rules: &[
        "`bias` takes the present load as zero and is kept until the next one or a restart.",
        "`overload` is true once when a component leaves its range, false once when all are back; values stay as measured.",
        "A sample the sensor could not take has stamp 0.",
    ],
    tried_by: "",
    interfaces: &[Interface {
        name: "force_sensor",
        doc: "The load.",
        required: true,
        commands: &[
            read("measured_cf", true, "Wrench", "Force and torque as measured last, less the bias."),
            read("range", true, "ForceRange", "What the sensor can measure, and how well."),
            void("bias", true, "Take the present load as zero."),
        ],
        events: &[event("overload", true, "bool", "A component left its range, or all are back.")],
    }],
    outputs: &[Output {
        name: "wrench",
        doc: "Each measurement.",
        required: true,
        one_of: &[Flows::Samples("Wrench")],
    }],
};

/// A pedal, joystick or gamepad.
pub const INPUT: Contract = Contract {
    name: "input",
    doc: "An input device of the operator: pedal, joystick, gamepad.",
    safety: "sensor",
    frames: "Axes go from -1 to 1 (a pedal from 0 to 1) and are 0 at rest; names and order are those of `layout`.",
    threads: ONE_THREAD,
    rules: &[
        "A device that no longer answers is `connected` = false with all axes 0 and no button pressed, within 0.1 s.",
        "`button` comes once for each press and each release, in order.",
        "After Start, a button counts as pressed only when it was seen released before: a stuck pedal starts nothing.",
    ],
    tried_by: "",
    interfaces: &[Interface {
        name: "input",
        doc: "Axes and buttons.",
        required: true,
        commands: &[
            read("input_state", true, "InputState", "Axes and buttons now."),
            read("layout", true, "InputLayout", "Names of axes and buttons."),
        ],
        events: &[event("button", true, "ButtonEvent", "A button was pressed or released.")],
    }],
    outputs: &[Output {
        name: "state",
        doc: "Axes and buttons, one sample per step.",
        required: true,
        one_of: &[Flows::Samples("InputState")],
    }],
};
