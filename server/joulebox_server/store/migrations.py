"""The tables. A migration is never edited once released: add another.

Times are microseconds since 1970 (`_at_us`), durations microseconds, energies microjoules; ids are UUIDv7 text.
Documents are JSON text, read and written whole: no query looks inside.
"""

import json

from sqlite_utils import Database, Migrations

migrations = Migrations("joulebox")

PEOPLE = (
    """CREATE TABLE token (
        id TEXT PRIMARY KEY, name TEXT NOT NULL, sha256 TEXT NOT NULL UNIQUE,
        role TEXT NOT NULL CHECK (role IN ('admin', 'operator', 'viewer', 'device')),
        device_id TEXT REFERENCES device (id) ON DELETE CASCADE,
        created_at_us INTEGER NOT NULL, revoked_at_us INTEGER)""",
    """CREATE TABLE enrollment (
        sha256 TEXT PRIMARY KEY, name TEXT, created_at_us INTEGER NOT NULL,
        expires_at_us INTEGER NOT NULL, used_at_us INTEGER)""",
    """CREATE TABLE device (
        id TEXT PRIMARY KEY, name TEXT NOT NULL, boot_id TEXT NOT NULL,
        health TEXT NOT NULL CHECK (health IN ('good', 'suspect', 'maintenance', 'retired')),
        created_at_us INTEGER NOT NULL, last_seen_at_us INTEGER NOT NULL, revoked_at_us INTEGER)""",
    "CREATE UNIQUE INDEX device_name ON device (name) WHERE revoked_at_us IS NULL",
    """CREATE TABLE device_capabilities (
        device_id TEXT PRIMARY KEY REFERENCES device (id) ON DELETE CASCADE,
        document TEXT NOT NULL, updated_at_us INTEGER NOT NULL)""",
)

WORK = (
    """CREATE TABLE blob (
        sha256 TEXT PRIMARY KEY, size_bytes INTEGER NOT NULL, created_at_us INTEGER NOT NULL)""",
    """CREATE TABLE scene (
        id TEXT PRIMARY KEY, name TEXT NOT NULL, bundle_sha256 TEXT NOT NULL REFERENCES blob (sha256),
        created_at_us INTEGER NOT NULL, UNIQUE (name, bundle_sha256))""",
    """CREATE TABLE sweep (
        id TEXT PRIMARY KEY, name TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('running', 'paused', 'cancelled', 'done', 'failed')),
        definition TEXT NOT NULL, created_at_us INTEGER NOT NULL)""",
    """CREATE TABLE sweep_scene (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        label TEXT NOT NULL, scene_id TEXT NOT NULL REFERENCES scene (id), defines TEXT NOT NULL,
        position INTEGER NOT NULL, UNIQUE (sweep_id, label))""",
    # A target is a device, or the wish for one: the first that fits and asks for work becomes it.
    """CREATE TABLE target (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        device_id TEXT REFERENCES device (id), requires TEXT, position INTEGER NOT NULL)""",
    """CREATE TABLE configuration (
        id TEXT PRIMARY KEY, sha256 TEXT NOT NULL UNIQUE, settings TEXT NOT NULL)""",
    """CREATE TABLE sweep_configuration (
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        configuration_id TEXT NOT NULL REFERENCES configuration (id),
        purpose TEXT NOT NULL, changed TEXT NOT NULL, position INTEGER NOT NULL,
        PRIMARY KEY (sweep_id, configuration_id, purpose))""",
    """CREATE TABLE job (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        target_id TEXT NOT NULL REFERENCES target (id) ON DELETE CASCADE,
        sweep_scene_id TEXT NOT NULL REFERENCES sweep_scene (id) ON DELETE CASCADE,
        configuration_id TEXT NOT NULL REFERENCES configuration (id),
        purpose TEXT NOT NULL CHECK (purpose IN ('measure', 'reference', 'noise_floor')),
        repeat INTEGER NOT NULL, seed INTEGER NOT NULL, block INTEGER NOT NULL, position INTEGER NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('queued', 'leased', 'done', 'failed', 'cancelled')),
        attempts INTEGER NOT NULL DEFAULT 0, not_before_us INTEGER NOT NULL DEFAULT 0, reason TEXT,
        UNIQUE (sweep_id, target_id, configuration_id, sweep_scene_id, purpose, repeat))""",
    "CREATE INDEX sweep_state ON sweep (state)",
    "CREATE INDEX target_sweep ON target (sweep_id)",
    "CREATE INDEX job_queue ON job (target_id, state, block, position, id)",
    "CREATE INDEX job_scene ON job (target_id, sweep_scene_id, purpose)",
    "CREATE INDEX job_sweep ON job (sweep_id, state)",
    """CREATE TABLE attempt (
        id TEXT PRIMARY KEY, job_id TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
        device_id TEXT NOT NULL REFERENCES device (id), boot_id TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('leased', 'released', 'expired', 'finished')),
        conditions TEXT NOT NULL, leased_at_us INTEGER NOT NULL, expires_at_us INTEGER NOT NULL, reason TEXT)""",
    "CREATE INDEX attempt_expiry ON attempt (expires_at_us) WHERE state = 'leased'",
    "CREATE INDEX attempt_job ON attempt (job_id)",
)

FINDINGS = (
    """CREATE TABLE result (
        id TEXT PRIMARY KEY, attempt_id TEXT NOT NULL UNIQUE REFERENCES attempt (id) ON DELETE CASCADE,
        job_id TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        device_id TEXT NOT NULL REFERENCES device (id),
        body_sha256 TEXT NOT NULL, document TEXT NOT NULL, accepted TEXT NOT NULL,
        method TEXT NOT NULL, quality TEXT NOT NULL, void TEXT,
        images INTEGER NOT NULL, windows INTEGER NOT NULL,
        time_us INTEGER, time_low_us INTEGER, time_high_us INTEGER,
        cpu_us INTEGER, energy_uj INTEGER, energy_low_uj INTEGER, energy_high_uj INTEGER,
        pixel_sha256 TEXT, image_sha256 TEXT REFERENCES blob (sha256),
        samples_sha256 TEXT REFERENCES blob (sha256), received_at_us INTEGER NOT NULL)""",
    "CREATE INDEX result_job ON result (job_id)",
    "CREATE INDEX result_sweep ON result (sweep_id, id)",
    "CREATE INDEX result_image ON result (image_sha256)",
    "CREATE INDEX result_samples ON result (samples_sha256)",
    """CREATE TABLE stage (
        result_id TEXT NOT NULL REFERENCES result (id) ON DELETE CASCADE, name TEXT NOT NULL,
        time_us INTEGER NOT NULL, cpu_us INTEGER, rays INTEGER, energy_uj INTEGER,
        PRIMARY KEY (result_id, name))""",
    """CREATE TABLE image_difference (
        id TEXT PRIMARY KEY, reference_sha256 TEXT NOT NULL, test_sha256 TEXT NOT NULL,
        metric TEXT NOT NULL, metric_version INTEGER NOT NULL, display TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('pending', 'done', 'failed')),
        tries INTEGER NOT NULL DEFAULT 0, value REAL, outcome TEXT, reason TEXT,
        delta_sha256 TEXT REFERENCES blob (sha256), created_at_us INTEGER NOT NULL,
        UNIQUE (reference_sha256, test_sha256, metric, metric_version, display))""",
    "CREATE INDEX image_difference_delta ON image_difference (delta_sha256)",
    "CREATE INDEX image_difference_pending ON image_difference (id) WHERE state = 'pending'",
    # Which pictures a sweep compares: a repeat (or the reference at another seed) with its reference.
    """CREATE TABLE comparison (
        result_id TEXT PRIMARY KEY REFERENCES result (id) ON DELETE CASCADE,
        reference_result_id TEXT NOT NULL REFERENCES result (id) ON DELETE CASCADE,
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        difference_id TEXT NOT NULL REFERENCES image_difference (id))""",
    "CREATE INDEX comparison_sweep ON comparison (sweep_id)",
    "CREATE INDEX comparison_difference ON comparison (difference_id)",
    """CREATE TABLE event (
        id INTEGER PRIMARY KEY AUTOINCREMENT, type TEXT NOT NULL, sweep_id TEXT,
        data TEXT NOT NULL, at_us INTEGER NOT NULL)""",
    """CREATE TABLE idempotency (
        key_sha256 TEXT PRIMARY KEY, body_sha256 TEXT NOT NULL,
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE, created_at_us INTEGER NOT NULL)""",
)


@migrations()
def first_tables(db: Database) -> None:
    """Everything of version 0.1."""
    for statement in (*PEOPLE, *WORK, *FINDINGS):
        db.execute(statement)


# A job may be a control run, and be timed without its joules ("time everything, meter few").
JOB_WITH_CONTROLS = """CREATE TABLE job_with_controls (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        target_id TEXT NOT NULL REFERENCES target (id) ON DELETE CASCADE,
        sweep_scene_id TEXT NOT NULL REFERENCES sweep_scene (id) ON DELETE CASCADE,
        configuration_id TEXT NOT NULL REFERENCES configuration (id),
        purpose TEXT NOT NULL CHECK (purpose IN ('measure', 'reference', 'noise_floor', 'control')),
        repeat INTEGER NOT NULL, seed INTEGER NOT NULL, block INTEGER NOT NULL, position INTEGER NOT NULL,
        metered INTEGER NOT NULL DEFAULT 1,
        state TEXT NOT NULL CHECK (state IN ('queued', 'leased', 'done', 'failed', 'cancelled')),
        attempts INTEGER NOT NULL DEFAULT 0, not_before_us INTEGER NOT NULL DEFAULT 0, reason TEXT,
        UNIQUE (sweep_id, target_id, configuration_id, sweep_scene_id, purpose, repeat))"""

CONTROLS = (
    JOB_WITH_CONTROLS,
    """INSERT INTO job_with_controls (id, sweep_id, target_id, sweep_scene_id, configuration_id, purpose, repeat,
        seed, block, position, metered, state, attempts, not_before_us, reason)
        SELECT id, sweep_id, target_id, sweep_scene_id, configuration_id, purpose, repeat, seed, block, position,
        CASE purpose WHEN 'noise_floor' THEN 0 ELSE 1 END, state, attempts, not_before_us, reason FROM job""",
    "DROP TABLE job",
    "ALTER TABLE job_with_controls RENAME TO job",
    "CREATE INDEX job_queue ON job (target_id, state, block, position, id)",
    "CREATE INDEX job_scene ON job (target_id, sweep_scene_id, purpose)",
    "CREATE INDEX job_sweep ON job (sweep_id, state)",
    # How far a control run is from the first of its scene and device: 1.02 is 2 % more.
    """CREATE TABLE control_run (
        result_id TEXT PRIMARY KEY REFERENCES result (id) ON DELETE CASCADE,
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        target_id TEXT NOT NULL REFERENCES target (id) ON DELETE CASCADE,
        sweep_scene_id TEXT NOT NULL REFERENCES sweep_scene (id) ON DELETE CASCADE,
        block INTEGER NOT NULL, time_ratio REAL NOT NULL, energy_ratio REAL)""",
    "CREATE INDEX control_run_sweep ON control_run (sweep_id)",
)

CARE = (
    "ALTER TABLE device ADD COLUMN failures_in_row INTEGER NOT NULL DEFAULT 0",
    "ALTER TABLE device ADD COLUMN health_reason TEXT",
    # Counted up by whatever an operator can change; the ETag.
    "ALTER TABLE device ADD COLUMN version INTEGER NOT NULL DEFAULT 1",
    "ALTER TABLE sweep ADD COLUMN version INTEGER NOT NULL DEFAULT 1",
    # What lists show of the document: without the settings' schema, which is long. And what it was built from.
    "ALTER TABLE device_capabilities ADD COLUMN shown TEXT",
    "ALTER TABLE device_capabilities ADD COLUMN build TEXT",
    "CREATE INDEX attempt_device ON attempt (device_id) WHERE state = 'leased'",
)

AGREEMENT = (
    # Equal for pictures that every device should render alike; the class within which every bit is the same.
    "ALTER TABLE result ADD COLUMN picture_key TEXT",
    "ALTER TABLE result ADD COLUMN render_class TEXT",
    "CREATE INDEX result_picture ON result (picture_key, render_class)",
    "CREATE INDEX result_device ON result (device_id, id)",
    # `agrees` is NULL while the difference is computed.
    """CREATE TABLE picture_check (
        id TEXT PRIMARY KEY, result_id TEXT NOT NULL REFERENCES result (id) ON DELETE CASCADE,
        other_result_id TEXT NOT NULL REFERENCES result (id) ON DELETE CASCADE,
        device_id TEXT NOT NULL REFERENCES device (id), other_device_id TEXT NOT NULL REFERENCES device (id),
        same_class INTEGER NOT NULL, agrees INTEGER, p99_jnd REAL,
        difference_id TEXT REFERENCES image_difference (id) ON DELETE SET NULL,
        UNIQUE (result_id, other_result_id))""",
    "CREATE INDEX picture_check_other ON picture_check (other_result_id)",
    "CREATE INDEX picture_check_difference ON picture_check (difference_id)",
    "CREATE INDEX picture_check_device ON picture_check (device_id, id) WHERE agrees = 0",
    "CREATE INDEX picture_check_other_device ON picture_check (other_device_id, id) WHERE agrees = 0",
    "CREATE INDEX image_difference_test ON image_difference (test_sha256)",
)


@migrations()
def controls_and_care(db: Database) -> None:
    """Control runs, metering by job, suspect devices, ETags, and pictures checked across devices."""
    for statement in (*CONTROLS, *CARE, *AGREEMENT):
        db.execute(statement)
    for device_id, text in db.execute("SELECT device_id, document FROM device_capabilities").fetchall():
        document = json.loads(text)
        renderer = document.get("renderer")
        if renderer:
            renderer.pop("settings_schema", None)
        build = f"{renderer['name']} {renderer['version']}" if renderer else None
        db.execute(
            "UPDATE device_capabilities SET shown = ?, build = ? WHERE device_id = ?",
            (json.dumps(document), build, device_id),
        )


SUSPICION = (
    # Whether the attempt failed, and whether that is still held against its device: since its last good result.
    "ALTER TABLE attempt ADD COLUMN failed INTEGER NOT NULL DEFAULT 0",
    "ALTER TABLE attempt ADD COLUMN in_row INTEGER NOT NULL DEFAULT 0",
    "CREATE INDEX attempt_in_row ON attempt (device_id) WHERE in_row = 1",
    "CREATE INDEX job_configuration ON job (configuration_id)",
    "CREATE INDEX sweep_scene_scene ON sweep_scene (scene_id)",
)


@migrations()
def failures_of_devices(db: Database) -> None:
    """Which attempts failed, so that a device's failures are told from its work's."""
    for statement in SUSPICION:
        db.execute(statement)
