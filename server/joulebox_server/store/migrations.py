"""The tables. A migration is never edited once released: add another.

Times are microseconds since 1970 (`_at_us`), durations microseconds, energies microjoules; ids are UUIDv7 text.
Documents are JSON text, read and written whole: no query looks inside.
"""

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
