"""Hold what the help says about each command."""

from __future__ import annotations

#: For each command: a phrase for the list of commands and its own page, sentences for its own page, and an example or "".
TEXTS: dict[str, tuple[str, str, str]] = {
    "demo": (
        "run the whole pipeline on a synthetic performer and write a report",
        "It needs no camera, no network and no display. The folder then holds actor.npz, result.npz and report.html.",
        "",
    ),
    "capture": (
        "build a personal rig (actor.npz) from a neutral scan",
        "The recording shows the resting face, seen from the front and while the head turns.",
        "adaptiveface capture my-scan --out actor.npz --neutral-frames 100:140",
    ),
    "track": (
        "track every frame of a recording (result.npz)",
        "Without --actor, the rig is captured from the recording, which should begin with the resting face. A video need not.",
        "adaptiveface track my-take --actor actor.npz --out result.npz --report report",
    ),
    "record": (
        "record a sensor to a folder that capture and track read",
        "Frames are written as the sensor gives them, without being tracked.",
        "adaptiveface record realsense --out my-take --seconds 20",
    ),
    "convert": (
        "convert a vendor's recording to a folder that capture and track read",
        "The formats are .bag, .db3, .r3d, .oni and .mkv; docs/sensors.md says what each of them needs.",
        "",
    ),
    "export": (
        "write a result as an animated character, curves or a video",
        "Without --character, the actor's own mesh is written.",
        "adaptiveface export result.npz --format glb --character hag",
    ),
    "stream": (
        "track a recording or a phone and send every frame to an avatar",
        "Blendshapes, head and eyes are sent over the network, by default to this machine.",
        "adaptiveface stream my-take --actor actor.npz --vmc 127.0.0.1:39539",
    ),
    "live": (
        "open a sensor, lead through the neutral scan, and track",
        "The live view is a notebook in the browser. With --headless everything happens in this terminal.",
        "adaptiveface live realsense --headless --actor actor.npz --out result.npz",
    ),
    "batch": (
        "capture, track and score many recordings",
        "If it is started again with the same options, it continues where it was stopped.",
        "adaptiveface batch my-takes --out results --sweep laplacian.w2=0.5,1.5,5",
    ),
    "evaluate": (
        "score results, or the meshes of another tracker, against the truth",
        "Several pairs give the mean over the performers, with its confidence interval.",
        "adaptiveface evaluate result.npz my-take",
    ),
    "paper": (
        "draw the paper's figures again from synthetic performances",
        "Every figure is drawn with the parameters of the paper and with our defaults.",
        "",
    ),
    "bench": (
        "time every stage, beside the paper's figures and other libraries",
        'Libraries to compare with are timed where they are installed: pip install "adaptiveface[bench]".',
        "",
    ),
    "lab": (
        "open JupyterLab on a copy of the notebooks",
        "The server can be reached from this machine only. Notebooks that you changed stay as they are.",
        "",
    ),
    "exercises": (
        "list the exercises, make a student copy, or grade a class",
        "Without an option, the exercises are listed.",
        "",
    ),
    "doctor": (
        "check the installation and say how to repair it",
        "The exit status is 0 when everything that is needed works.",
        "",
    ),
}
