BEGIN TRANSACTION;
CREATE TABLE "_sqlite_migrations" (
   "id" INTEGER PRIMARY KEY,
   "migration_set" TEXT,
   "name" TEXT,
   "applied_at" TEXT
);
INSERT INTO "_sqlite_migrations" VALUES(1,'joulebox','first_tables','2026-11-22 12:18:32.319985+00:00');
CREATE TABLE attempt (
        id TEXT PRIMARY KEY, job_id TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
        device_id TEXT NOT NULL REFERENCES device (id), boot_id TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('leased', 'released', 'expired', 'finished')),
        conditions TEXT NOT NULL, leased_at_us INTEGER NOT NULL, expires_at_us INTEGER NOT NULL, reason TEXT);
INSERT INTO "attempt" VALUES('01a20331-9b95-7f90-b8f2-e4dfd266395a','01a20331-9b89-757a-a265-cd2e3a9b7045','01a20331-9b60-7bc9-b64c-a5afb06fcc33','boot-1','finished','{}',1795349912466932,1795350223466932,NULL);
INSERT INTO "attempt" VALUES('01a20331-9bbd-7bd3-9179-5693eba9d10c','01a20331-9b8a-7d4f-bad1-5afc5b7b98f9','01a20331-9b60-7bc9-b64c-a5afb06fcc33','boot-1','finished','{}',1795349912507557,1795350223507557,NULL);
INSERT INTO "attempt" VALUES('01a20331-9bd6-71ee-9424-68c97b1e7ffe','01a20331-9b8b-7269-97f8-b8f5f32cb8c1','01a20331-9b60-7bc9-b64c-a5afb06fcc33','boot-1','finished','{}',1795349912533691,1795350223533691,NULL);
INSERT INTO "attempt" VALUES('01a20331-9c86-734b-b87c-f55305a2926f','01a20331-9b8c-7af8-9665-2fed8bcf1e1f','01a20331-9b60-7bc9-b64c-a5afb06fcc33','boot-1','finished','{}',1795349912708413,1795350223708413,NULL);
INSERT INTO "attempt" VALUES('01a20331-9d17-79e7-bea9-020e37f0214c','01a20331-9d13-7f88-998e-db7c861dc382','01a20331-9b60-7bc9-b64c-a5afb06fcc33','boot-1','released','{}',1795349912855164,1795350223855164,'warm');
INSERT INTO "attempt" VALUES('01a20331-9d25-7ec9-9e9d-3bf35625c97a','01a20331-9d13-7f88-998e-db7c861dc382','01a20331-9b60-7bc9-b64c-a5afb06fcc33','boot-1','leased','{}',1795349912869128,1795350223869128,NULL);
CREATE TABLE blob (
        sha256 TEXT PRIMARY KEY, size_bytes INTEGER NOT NULL, created_at_us INTEGER NOT NULL);
INSERT INTO "blob" VALUES('678859c8c6eb308a051043647192a1cb2f67a5bc9b7c4b416266d2222fb86f7e',140,1795349912401406);
INSERT INTO "blob" VALUES('e62ede849d94a2efaa358e98ef667f1e77e1709e687b5808b56dcaaa5adf2dd7',12416,1795349912489986);
INSERT INTO "blob" VALUES('c5cf63dbd7665afd847ac15b45ade7fef3a13c93810d6ad3fc86585c847b1445',12416,1795349912515226);
INSERT INTO "blob" VALUES('46b67bdea8b2f832d7e6c378b87a045e5eff334527953cb64350068279f2beaa',12416,1795349912550010);
INSERT INTO "blob" VALUES('58b4b4e5f86f0fe438177b92e5efb08ef5eb4487d5e6f53370bcd04a11bb2517',732,1795349912685411);
INSERT INTO "blob" VALUES('44bc5a065517066c706dbe2826c5c27f3b728c45bcae9e1b88002a8644e040bc',851,1795349912706430);
INSERT INTO "blob" VALUES('58371179afbb66e24b138a3e93bfc442c44192f1f8dafb27491ffa51dfef27df',12416,1795349912724494);
INSERT INTO "blob" VALUES('bbbc863add7c0924662cd4e57c35731dec275190684f2833b4e66ccace36a38a',1010,1795349912825709);
CREATE TABLE comparison (
        result_id TEXT PRIMARY KEY REFERENCES result (id) ON DELETE CASCADE,
        reference_result_id TEXT NOT NULL REFERENCES result (id) ON DELETE CASCADE,
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        difference_id TEXT NOT NULL REFERENCES image_difference (id));
INSERT INTO "comparison" VALUES('01a20331-9bc7-7e8e-89ea-5ab210db7ca5','01a20331-9bb4-7711-8c1f-ae00cf555e08','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9bc8-75a7-84c0-5493244fda24');
INSERT INTO "comparison" VALUES('01a20331-9c6e-7110-9447-b8c85db16163','01a20331-9bb4-7711-8c1f-ae00cf555e08','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9c6f-7649-877b-026f75d52c31');
INSERT INTO "comparison" VALUES('01a20331-9ca0-7679-a2ba-91816718dd6d','01a20331-9bb4-7711-8c1f-ae00cf555e08','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9ca1-73a7-ae83-33c5ab887534');
CREATE TABLE configuration (
        id TEXT PRIMARY KEY, sha256 TEXT NOT NULL UNIQUE, settings TEXT NOT NULL);
INSERT INTO "configuration" VALUES('01a20331-9b85-7a54-b68c-14062805d378','420fe1615777c48812bcbc946343b6cdacf900312d0c454836a1a556d697968c','{"global_photons":10000,"height":32,"seed":0,"width":32}');
INSERT INTO "configuration" VALUES('01a20331-9b86-7b8f-8fe4-0ff5d1fb8f07','20fda9c1d6f3f98443dc6c555eac56c0feb6e7f59b04d09984a45790a7bf0403','{"global_photons":50000,"height":32,"seed":0,"width":32}');
INSERT INTO "configuration" VALUES('01a20331-9b87-7474-bcbf-50ac4a297242','325342be539aee89dc8eabe44dd74e1ff5fdd0e13c735c22247dcb323d50ea00','{"height":32,"preset":"reference","seed":0,"width":32}');
INSERT INTO "configuration" VALUES('01a20331-9d10-7ee7-8e1f-63220aacc097','a04c04ba9fc5f914fb06d3112b5eb76a4878ea8bb78dcd90734f1d04a0e2fd9b','{"height":32,"seed":0,"width":32}');
CREATE TABLE device (
        id TEXT PRIMARY KEY, name TEXT NOT NULL, boot_id TEXT NOT NULL,
        health TEXT NOT NULL CHECK (health IN ('good', 'suspect', 'maintenance', 'retired')),
        created_at_us INTEGER NOT NULL, last_seen_at_us INTEGER NOT NULL, revoked_at_us INTEGER);
INSERT INTO "device" VALUES('01a20331-9b60-7bc9-b64c-a5afb06fcc33','laptop','boot-1','good',1795349912416546,1795349912869128,NULL);
CREATE TABLE device_capabilities (
        device_id TEXT PRIMARY KEY REFERENCES device (id) ON DELETE CASCADE,
        document TEXT NOT NULL, updated_at_us INTEGER NOT NULL);
INSERT INTO "device_capabilities" VALUES('01a20331-9b60-7bc9-b64c-a5afb06fcc33','{"agent_version":"0.1.0","cores":2,"energy_methods":[{"available":true,"method":"battery_gauge","reason":null,"scope":"whole machine"}],"isa":"x86-64-v3","machine":"x86_64","os":"Debian 13","platform":"linux","renderer":{"name":"fake","settings_schema":{"$defs":{"Indirect":{"enum":["none","direct_visualization","final_gather","path"],"type":"string"}},"$schema":"https://json-schema.org/draft/2020-12/schema","additionalProperties":false,"properties":{"gather_count":{"default":100,"minimum":1,"type":"integer"},"global_photons":{"default":100000,"minimum":0,"type":"integer"},"height":{"anyOf":[{"maximum":16384,"minimum":1,"type":"integer"},{"type":"null"}],"default":null},"indirect":{"$ref":"#/$defs/Indirect","default":"direct_visualization"},"seed":{"default":0,"minimum":0,"type":"integer"},"width":{"default":32,"maximum":16384,"minimum":1,"type":"integer"}},"type":"object"},"version":"1"}}',1795349912428766);
CREATE TABLE enrollment (
        sha256 TEXT PRIMARY KEY, name TEXT, created_at_us INTEGER NOT NULL,
        expires_at_us INTEGER NOT NULL, used_at_us INTEGER);
INSERT INTO "enrollment" VALUES('60817b54ab7a986b184317ce47b02d7e47ab292c64b95ea7a0d5c646d8cb7a8e',NULL,1795349912411271,1795350812411271,1795349912416432);
CREATE TABLE event (
        id INTEGER PRIMARY KEY AUTOINCREMENT, type TEXT NOT NULL, sweep_id TEXT,
        data TEXT NOT NULL, at_us INTEGER NOT NULL);
INSERT INTO "event" VALUES(1,'device',NULL,'{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","name":"laptop","state":"enrolled","sweep_id":null}',1795349912416699);
INSERT INTO "event" VALUES(2,'device',NULL,'{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","state":"ready","sweep_id":null}',1795349912428951);
INSERT INTO "event" VALUES(3,'sweep','01a20331-9b83-7a2b-b462-2af18dfeac96','{"state":"running","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912453918);
INSERT INTO "event" VALUES(4,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","job_id":"01a20331-9b89-757a-a265-cd2e3a9b7045","reason":null,"state":"leased","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912469631);
INSERT INTO "event" VALUES(5,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b89-757a-a265-cd2e3a9b7045","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912501783);
INSERT INTO "event" VALUES(6,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","job_id":"01a20331-9b8a-7d4f-bad1-5afc5b7b98f9","reason":null,"state":"leased","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912509918);
INSERT INTO "event" VALUES(7,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b8a-7d4f-bad1-5afc5b7b98f9","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912520709);
INSERT INTO "event" VALUES(8,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","job_id":"01a20331-9b8b-7269-97f8-b8f5f32cb8c1","reason":null,"state":"leased","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912534905);
INSERT INTO "event" VALUES(9,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b8b-7269-97f8-b8f5f32cb8c1","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912687102);
INSERT INTO "event" VALUES(10,'difference','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b8a-7d4f-bad1-5afc5b7b98f9","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96","value":0.003162970354439458}',1795349912688199);
INSERT INTO "event" VALUES(11,'difference','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b8b-7269-97f8-b8f5f32cb8c1","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96","value":0.02411382971548068}',1795349912709975);
INSERT INTO "event" VALUES(12,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","job_id":"01a20331-9b8c-7af8-9665-2fed8bcf1e1f","reason":null,"state":"leased","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912711056);
INSERT INTO "event" VALUES(13,'job','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b8c-7af8-9665-2fed8bcf1e1f","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912738193);
INSERT INTO "event" VALUES(14,'difference','01a20331-9b83-7a2b-b462-2af18dfeac96','{"job_id":"01a20331-9b8c-7af8-9665-2fed8bcf1e1f","reason":null,"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96","value":0.28134788131713984}',1795349912829637);
INSERT INTO "event" VALUES(15,'sweep','01a20331-9b83-7a2b-b462-2af18dfeac96','{"state":"done","sweep_id":"01a20331-9b83-7a2b-b462-2af18dfeac96"}',1795349912829812);
INSERT INTO "event" VALUES(16,'sweep','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','{"state":"running","sweep_id":"01a20331-9d0e-7d86-8156-a7c29fcd8cd8"}',1795349912847699);
INSERT INTO "event" VALUES(17,'job','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","job_id":"01a20331-9d13-7f88-998e-db7c861dc382","reason":null,"state":"leased","sweep_id":"01a20331-9d0e-7d86-8156-a7c29fcd8cd8"}',1795349912856115);
INSERT INTO "event" VALUES(18,'job','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','{"job_id":"01a20331-9d13-7f88-998e-db7c861dc382","reason":"warm","state":"queued","sweep_id":"01a20331-9d0e-7d86-8156-a7c29fcd8cd8"}',1795349912862656);
INSERT INTO "event" VALUES(19,'job','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','{"device_id":"01a20331-9b60-7bc9-b64c-a5afb06fcc33","job_id":"01a20331-9d13-7f88-998e-db7c861dc382","reason":null,"state":"leased","sweep_id":"01a20331-9d0e-7d86-8156-a7c29fcd8cd8"}',1795349912869900);
CREATE TABLE idempotency (
        key_sha256 TEXT PRIMARY KEY, body_sha256 TEXT NOT NULL,
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE, created_at_us INTEGER NOT NULL);
CREATE TABLE image_difference (
        id TEXT PRIMARY KEY, reference_sha256 TEXT NOT NULL, test_sha256 TEXT NOT NULL,
        metric TEXT NOT NULL, metric_version INTEGER NOT NULL, display TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('pending', 'done', 'failed')),
        tries INTEGER NOT NULL DEFAULT 0, value REAL, outcome TEXT, reason TEXT,
        delta_sha256 TEXT REFERENCES blob (sha256), created_at_us INTEGER NOT NULL,
        UNIQUE (reference_sha256, test_sha256, metric, metric_version, display));
INSERT INTO "image_difference" VALUES('01a20331-9bc8-75a7-84c0-5493244fda24','e62ede849d94a2efaa358e98ef667f1e77e1709e687b5808b56dcaaa5adf2dd7','c5cf63dbd7665afd847ac15b45ade7fef3a13c93810d6ad3fc86585c847b1445','ltdiff-style',1,'{"exposure":1.0}','done',0,3.16297035443945800947e-03,'{"acceptable":true,"display":{"black_cd_m2":1.0,"exposure":1.0,"peak_cd_m2":100.0,"pixels_per_degree":4.0,"tone_map":"clip"},"flip_mean":0.007103517185896635,"height":32,"limit":1.5625,"max_jnd":1.825137734413147,"p99_jnd":1.3688887357711792,"relmse":1.968102675283288e-05,"rmse_srgb":0.0012233373278308704,"share_above_3_jnd":0.0,"ssim":0.9996574521064758,"value":0.003162970354439458,"value_per_pixel":3.0888382367572832e-06,"width":32}',NULL,'58b4b4e5f86f0fe438177b92e5efb08ef5eb4487d5e6f53370bcd04a11bb2517',1795349912520400);
INSERT INTO "image_difference" VALUES('01a20331-9c6f-7649-877b-026f75d52c31','e62ede849d94a2efaa358e98ef667f1e77e1709e687b5808b56dcaaa5adf2dd7','46b67bdea8b2f832d7e6c378b87a045e5eff334527953cb64350068279f2beaa','ltdiff-style',1,'{"exposure":1.0}','done',0,2.41138297154806814648e-02,'{"acceptable":true,"display":{"black_cd_m2":1.0,"exposure":1.0,"peak_cd_m2":100.0,"pixels_per_degree":4.0,"tone_map":"clip"},"flip_mean":0.01116565428674221,"height":32,"limit":1.5625,"max_jnd":3.4259328842163086,"p99_jnd":2.287076473236084,"relmse":5.8177128050918666e-05,"rmse_srgb":0.002101162876788838,"share_above_3_jnd":0.00390625,"ssim":0.9989545941352844,"value":0.02411382971548068,"value_per_pixel":2.3548661831524103e-05,"width":32}',NULL,'44bc5a065517066c706dbe2826c5c27f3b728c45bcae9e1b88002a8644e040bc',1795349912686884);
INSERT INTO "image_difference" VALUES('01a20331-9ca1-73a7-ae83-33c5ab887534','e62ede849d94a2efaa358e98ef667f1e77e1709e687b5808b56dcaaa5adf2dd7','58371179afbb66e24b138a3e93bfc442c44192f1f8dafb27491ffa51dfef27df','ltdiff-style',1,'{"exposure":1.0}','done',0,2.81347881317139836276e-01,'{"acceptable":true,"display":{"black_cd_m2":1.0,"exposure":1.0,"peak_cd_m2":100.0,"pixels_per_degree":4.0,"tone_map":"clip"},"flip_mean":0.017539799213409424,"height":32,"limit":1.5625,"max_jnd":7.04589319229126,"p99_jnd":4.845823764801025,"relmse":0.000257159713534049,"rmse_srgb":0.004376658495164171,"share_above_3_jnd":0.060546875,"ssim":0.9957006573677063,"value":0.28134788131713984,"value_per_pixel":0.00027475379034876937,"width":32}',NULL,'bbbc863add7c0924662cd4e57c35731dec275190684f2833b4e66ccace36a38a',1795349912737870);
CREATE TABLE job (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        target_id TEXT NOT NULL REFERENCES target (id) ON DELETE CASCADE,
        sweep_scene_id TEXT NOT NULL REFERENCES sweep_scene (id) ON DELETE CASCADE,
        configuration_id TEXT NOT NULL REFERENCES configuration (id),
        purpose TEXT NOT NULL CHECK (purpose IN ('measure', 'reference', 'noise_floor')),
        repeat INTEGER NOT NULL, seed INTEGER NOT NULL, block INTEGER NOT NULL, position INTEGER NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('queued', 'leased', 'done', 'failed', 'cancelled')),
        attempts INTEGER NOT NULL DEFAULT 0, not_before_us INTEGER NOT NULL DEFAULT 0, reason TEXT,
        UNIQUE (sweep_id, target_id, configuration_id, sweep_scene_id, purpose, repeat));
INSERT INTO "job" VALUES('01a20331-9b89-757a-a265-cd2e3a9b7045','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b88-7054-ad10-6117559693ee','01a20331-9b84-7a66-b479-a13b98eece41','01a20331-9b87-7474-bcbf-50ac4a297242','reference',0,1000,-1,0,'done',0,0,NULL);
INSERT INTO "job" VALUES('01a20331-9b8a-7d4f-bad1-5afc5b7b98f9','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b88-7054-ad10-6117559693ee','01a20331-9b84-7a66-b479-a13b98eece41','01a20331-9b87-7474-bcbf-50ac4a297242','noise_floor',0,2000,-1,0,'done',0,0,NULL);
INSERT INTO "job" VALUES('01a20331-9b8b-7269-97f8-b8f5f32cb8c1','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b88-7054-ad10-6117559693ee','01a20331-9b84-7a66-b479-a13b98eece41','01a20331-9b86-7b8f-8fe4-0ff5d1fb8f07','measure',0,0,0,0,'done',0,0,NULL);
INSERT INTO "job" VALUES('01a20331-9b8c-7af8-9665-2fed8bcf1e1f','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b88-7054-ad10-6117559693ee','01a20331-9b84-7a66-b479-a13b98eece41','01a20331-9b85-7a54-b68c-14062805d378','measure',0,0,0,1,'done',0,0,NULL);
INSERT INTO "job" VALUES('01a20331-9d13-7f88-998e-db7c861dc382','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','01a20331-9d12-71c4-b902-4d4aaef90b85','01a20331-9d0f-793d-919f-bc35b03c532b','01a20331-9b87-7474-bcbf-50ac4a297242','reference',0,1000,-1,0,'leased',0,1795349912862339,'warm');
INSERT INTO "job" VALUES('01a20331-9d14-707d-8f57-8c1d0fc9a157','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','01a20331-9d12-71c4-b902-4d4aaef90b85','01a20331-9d0f-793d-919f-bc35b03c532b','01a20331-9b87-7474-bcbf-50ac4a297242','noise_floor',0,2000,-1,0,'queued',0,0,NULL);
INSERT INTO "job" VALUES('01a20331-9d15-7827-a8f2-ad2292b5ab2b','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','01a20331-9d12-71c4-b902-4d4aaef90b85','01a20331-9d0f-793d-919f-bc35b03c532b','01a20331-9d10-7ee7-8e1f-63220aacc097','measure',0,0,0,0,'queued',0,0,NULL);
CREATE TABLE result (
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
        samples_sha256 TEXT REFERENCES blob (sha256), received_at_us INTEGER NOT NULL);
INSERT INTO "result" VALUES('01a20331-9bb4-7711-8c1f-ae00cf555e08','01a20331-9b95-7f90-b8f2-e4dfd266395a','01a20331-9b89-757a-a265-cd2e3a9b7045','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b60-7bc9-b64c-a5afb06fcc33','27eed03a6ff82afbcee816fb24bbc44f191d6a26a38eeea936374031f9c0dc03','{"conditions":{"after":{"charge_percent":79},"before":{"charge_percent":80}},"confidence":0.95,"cpu_s_per_image":{"high":2.652,"low":2.548,"value":2.6},"energy_j_per_image":{"counter":{"high":26.52,"low":25.48,"value":26.0},"gross":{"high":26.52,"low":25.48,"value":26.0},"net":null},"image_blob":"e62ede849d94a2efaa358e98ef667f1e77e1709e687b5808b56dcaaa5adf2dd7","images":50,"method":"battery_gauge","noise":null,"photons":{"global_stored":250000},"pixel_sha256":"09eff2118c66f886e4cdc161f4cb1869d5701632cb229cbc8d061f59d32b661c","plan":{"left_out":{"caustics":"no specular surface"},"run":["photon_map","direct","indirect"]},"power_samples":null,"quality":"measured","refresh_s":1.0,"renderer":{"intersector":"bvh","isa":"none","name":"fake","threads":1,"version":"1"},"scene":"box","scene_sha256":"678859c8c6eb308a051043647192a1cb2f67a5bc9b7c4b416266d2222fb86f7e","schema":1,"scope":"whole machine","settings":{"gather_count":100,"global_photons":250000,"height":32,"indirect":"direct_visualization","seed":1000,"width":32},"stages":{"direct":{"cpu_s":0.52,"energy_j":{"equation_2":5.2,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.52},"indirect":{"cpu_s":1.3,"energy_j":{"equation_2":13.0,"integrated":null,"regressed":null},"rays":1000.0,"time_s":1.3},"photon_map":{"cpu_s":0.78,"energy_j":{"equation_2":7.800000000000001,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.78}},"time_s_per_image":{"high":2.652,"low":2.548,"value":2.6},"void":null,"window_data":[],"window_s":1.0,"windows":5}','ok','battery_gauge','measured',NULL,50,5,2600000,2548000,2652000,2600000,26000000,25480000,26520000,'09eff2118c66f886e4cdc161f4cb1869d5701632cb229cbc8d061f59d32b661c','e62ede849d94a2efaa358e98ef667f1e77e1709e687b5808b56dcaaa5adf2dd7',NULL,1795349912500006);
INSERT INTO "result" VALUES('01a20331-9bc7-7e8e-89ea-5ab210db7ca5','01a20331-9bbd-7bd3-9179-5693eba9d10c','01a20331-9b8a-7d4f-bad1-5afc5b7b98f9','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b60-7bc9-b64c-a5afb06fcc33','3e0c3c1bdac9d21f78c6a8c0e974cb80f89b799e23b98a4acf78edd02095b0ed','{"conditions":{"after":{"charge_percent":79},"before":{"charge_percent":80}},"confidence":0.95,"cpu_s_per_image":{"high":2.652,"low":2.548,"value":2.6},"energy_j_per_image":{"counter":null,"gross":null,"net":null},"image_blob":"c5cf63dbd7665afd847ac15b45ade7fef3a13c93810d6ad3fc86585c847b1445","images":50,"method":"none","noise":null,"photons":{"global_stored":250000},"pixel_sha256":"04318f7910df0c741bda30715217137d43df994eb4a6e6c908ca379d9d51648c","plan":{"left_out":{"caustics":"no specular surface"},"run":["photon_map","direct","indirect"]},"power_samples":null,"quality":"none","refresh_s":null,"renderer":{"intersector":"bvh","isa":"none","name":"fake","threads":1,"version":"1"},"scene":"box","scene_sha256":"678859c8c6eb308a051043647192a1cb2f67a5bc9b7c4b416266d2222fb86f7e","schema":1,"scope":"whole machine","settings":{"gather_count":100,"global_photons":250000,"height":32,"indirect":"direct_visualization","seed":2000,"width":32},"stages":{"direct":{"cpu_s":0.52,"energy_j":{"equation_2":5.2,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.52},"indirect":{"cpu_s":1.3,"energy_j":{"equation_2":13.0,"integrated":null,"regressed":null},"rays":1000.0,"time_s":1.3},"photon_map":{"cpu_s":0.78,"energy_j":{"equation_2":7.800000000000001,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.78}},"time_s_per_image":{"high":2.652,"low":2.548,"value":2.6},"void":null,"window_data":[],"window_s":1.0,"windows":5}','ok','none','none',NULL,50,5,2600000,2548000,2652000,2600000,NULL,NULL,NULL,'04318f7910df0c741bda30715217137d43df994eb4a6e6c908ca379d9d51648c','c5cf63dbd7665afd847ac15b45ade7fef3a13c93810d6ad3fc86585c847b1445',NULL,1795349912519320);
INSERT INTO "result" VALUES('01a20331-9c6e-7110-9447-b8c85db16163','01a20331-9bd6-71ee-9424-68c97b1e7ffe','01a20331-9b8b-7269-97f8-b8f5f32cb8c1','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b60-7bc9-b64c-a5afb06fcc33','f8dec8c27c850b10b269d3b2979f0f71bffb86e2af24061732b1bd50687230b3','{"conditions":{"after":{"charge_percent":79},"before":{"charge_percent":80}},"confidence":0.95,"cpu_s_per_image":{"high":0.612,"low":0.588,"value":0.6},"energy_j_per_image":{"counter":{"high":6.12,"low":5.88,"value":6.0},"gross":{"high":6.12,"low":5.88,"value":6.0},"net":null},"image_blob":"46b67bdea8b2f832d7e6c378b87a045e5eff334527953cb64350068279f2beaa","images":50,"method":"battery_gauge","noise":null,"photons":{"global_stored":50000},"pixel_sha256":"ca06fb6e8135c11ede62f82bdd40807e2987053885c3dabd8d6495b7adb50d46","plan":{"left_out":{"caustics":"no specular surface"},"run":["photon_map","direct","indirect"]},"power_samples":null,"quality":"measured","refresh_s":1.0,"renderer":{"intersector":"bvh","isa":"none","name":"fake","threads":1,"version":"1"},"scene":"box","scene_sha256":"678859c8c6eb308a051043647192a1cb2f67a5bc9b7c4b416266d2222fb86f7e","schema":1,"scope":"whole machine","settings":{"gather_count":100,"global_photons":50000,"height":32,"indirect":"direct_visualization","seed":0,"width":32},"stages":{"direct":{"cpu_s":0.12,"energy_j":{"equation_2":1.2,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.12},"indirect":{"cpu_s":0.3,"energy_j":{"equation_2":3.0,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.3},"photon_map":{"cpu_s":0.18,"energy_j":{"equation_2":1.7999999999999998,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.18}},"time_s_per_image":{"high":0.612,"low":0.588,"value":0.6},"void":null,"window_data":[],"window_s":1.0,"windows":5}','ok','battery_gauge','measured',NULL,50,5,600000,588000,612000,600000,6000000,5880000,6120000,'ca06fb6e8135c11ede62f82bdd40807e2987053885c3dabd8d6495b7adb50d46','46b67bdea8b2f832d7e6c378b87a045e5eff334527953cb64350068279f2beaa',NULL,1795349912685593);
INSERT INTO "result" VALUES('01a20331-9ca0-7679-a2ba-91816718dd6d','01a20331-9c86-734b-b87c-f55305a2926f','01a20331-9b8c-7af8-9665-2fed8bcf1e1f','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b60-7bc9-b64c-a5afb06fcc33','2308fdc9f34ea8e380b285d24da7f1abc0a089506ab26e49ab8142238c645fc3','{"conditions":{"after":{"charge_percent":79},"before":{"charge_percent":80}},"confidence":0.95,"cpu_s_per_image":{"high":0.20400000000000001,"low":0.196,"value":0.2},"energy_j_per_image":{"counter":{"high":2.04,"low":1.96,"value":2.0},"gross":{"high":2.04,"low":1.96,"value":2.0},"net":null},"image_blob":"58371179afbb66e24b138a3e93bfc442c44192f1f8dafb27491ffa51dfef27df","images":50,"method":"battery_gauge","noise":null,"photons":{"global_stored":10000},"pixel_sha256":"b4bf578fd18312f7b4c9b8b8231474bac7243ac2692ee146c8b6ae929b088307","plan":{"left_out":{"caustics":"no specular surface"},"run":["photon_map","direct","indirect"]},"power_samples":null,"quality":"measured","refresh_s":1.0,"renderer":{"intersector":"bvh","isa":"none","name":"fake","threads":1,"version":"1"},"scene":"box","scene_sha256":"678859c8c6eb308a051043647192a1cb2f67a5bc9b7c4b416266d2222fb86f7e","schema":1,"scope":"whole machine","settings":{"gather_count":100,"global_photons":10000,"height":32,"indirect":"direct_visualization","seed":0,"width":32},"stages":{"direct":{"cpu_s":0.04000000000000001,"energy_j":{"equation_2":0.4,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.04000000000000001},"indirect":{"cpu_s":0.1,"energy_j":{"equation_2":1.0,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.1},"photon_map":{"cpu_s":0.06,"energy_j":{"equation_2":0.6000000000000001,"integrated":null,"regressed":null},"rays":1000.0,"time_s":0.06}},"time_s_per_image":{"high":0.20400000000000001,"low":0.196,"value":0.2},"void":null,"window_data":[],"window_s":1.0,"windows":5}','ok','battery_gauge','measured',NULL,50,5,200000,196000,204000,200000,2000000,1960000,2040000,'b4bf578fd18312f7b4c9b8b8231474bac7243ac2692ee146c8b6ae929b088307','58371179afbb66e24b138a3e93bfc442c44192f1f8dafb27491ffa51dfef27df',NULL,1795349912736180);
CREATE TABLE scene (
        id TEXT PRIMARY KEY, name TEXT NOT NULL, bundle_sha256 TEXT NOT NULL REFERENCES blob (sha256),
        created_at_us INTEGER NOT NULL, UNIQUE (name, bundle_sha256));
INSERT INTO "scene" VALUES('01a20331-9b51-7092-ae03-96d71461923c','box','678859c8c6eb308a051043647192a1cb2f67a5bc9b7c4b416266d2222fb86f7e',1795349912401618);
CREATE TABLE stage (
        result_id TEXT NOT NULL REFERENCES result (id) ON DELETE CASCADE, name TEXT NOT NULL,
        time_us INTEGER NOT NULL, cpu_us INTEGER, rays INTEGER, energy_uj INTEGER,
        PRIMARY KEY (result_id, name));
INSERT INTO "stage" VALUES('01a20331-9bb4-7711-8c1f-ae00cf555e08','photon_map',780000,780000,1000,7800000);
INSERT INTO "stage" VALUES('01a20331-9bb4-7711-8c1f-ae00cf555e08','direct',520000,520000,1000,5200000);
INSERT INTO "stage" VALUES('01a20331-9bb4-7711-8c1f-ae00cf555e08','indirect',1300000,1300000,1000,13000000);
INSERT INTO "stage" VALUES('01a20331-9bc7-7e8e-89ea-5ab210db7ca5','photon_map',780000,780000,1000,7800000);
INSERT INTO "stage" VALUES('01a20331-9bc7-7e8e-89ea-5ab210db7ca5','direct',520000,520000,1000,5200000);
INSERT INTO "stage" VALUES('01a20331-9bc7-7e8e-89ea-5ab210db7ca5','indirect',1300000,1300000,1000,13000000);
INSERT INTO "stage" VALUES('01a20331-9c6e-7110-9447-b8c85db16163','photon_map',180000,180000,1000,1800000);
INSERT INTO "stage" VALUES('01a20331-9c6e-7110-9447-b8c85db16163','direct',120000,120000,1000,1200000);
INSERT INTO "stage" VALUES('01a20331-9c6e-7110-9447-b8c85db16163','indirect',300000,300000,1000,3000000);
INSERT INTO "stage" VALUES('01a20331-9ca0-7679-a2ba-91816718dd6d','photon_map',60000,60000,1000,600000);
INSERT INTO "stage" VALUES('01a20331-9ca0-7679-a2ba-91816718dd6d','direct',40000,40000,1000,400000);
INSERT INTO "stage" VALUES('01a20331-9ca0-7679-a2ba-91816718dd6d','indirect',100000,100000,1000,1000000);
CREATE TABLE sweep (
        id TEXT PRIMARY KEY, name TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('running', 'paused', 'cancelled', 'done', 'failed')),
        definition TEXT NOT NULL, created_at_us INTEGER NOT NULL);
INSERT INTO "sweep" VALUES('01a20331-9b83-7a2b-b462-2af18dfeac96','small','done','{"axes":{"global_photons":[10000,50000]},"configurations":[],"devices":null,"exposure":1.0,"limit":100.0,"measure":{"half_width":0.05,"max_seconds":10.0,"max_windows":2,"min_windows":2,"window_s":1.0},"name":"small","preset":null,"reference":{"preset":null,"seed_policy":"other","settings":{}},"repeats":1,"requires":null,"rule":"grid","scenes":[{"defines":{},"name":"box"}],"settings":{"height":32,"width":32}}',1795349912451046);
INSERT INTO "sweep" VALUES('01a20331-9d0e-7d86-8156-a7c29fcd8cd8','second','running','{"axes":{},"configurations":[],"devices":["laptop"],"exposure":1.0,"limit":100.0,"measure":{"half_width":0.05,"max_seconds":10.0,"max_windows":2,"min_windows":2,"window_s":1.0},"name":"second","preset":null,"reference":{"preset":null,"seed_policy":"other","settings":{}},"repeats":1,"requires":null,"rule":"grid","scenes":[{"defines":{},"name":"box"}],"settings":{"height":32,"width":32}}',1795349912846959);
CREATE TABLE sweep_configuration (
        sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        configuration_id TEXT NOT NULL REFERENCES configuration (id),
        purpose TEXT NOT NULL, changed TEXT NOT NULL, position INTEGER NOT NULL,
        PRIMARY KEY (sweep_id, configuration_id, purpose));
INSERT INTO "sweep_configuration" VALUES('01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b85-7a54-b68c-14062805d378','measure','{"global_photons":10000}',0);
INSERT INTO "sweep_configuration" VALUES('01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b86-7b8f-8fe4-0ff5d1fb8f07','measure','{"global_photons":50000}',1);
INSERT INTO "sweep_configuration" VALUES('01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b87-7474-bcbf-50ac4a297242','reference','{}',-1);
INSERT INTO "sweep_configuration" VALUES('01a20331-9d0e-7d86-8156-a7c29fcd8cd8','01a20331-9d10-7ee7-8e1f-63220aacc097','measure','{}',0);
INSERT INTO "sweep_configuration" VALUES('01a20331-9d0e-7d86-8156-a7c29fcd8cd8','01a20331-9b87-7474-bcbf-50ac4a297242','reference','{}',-1);
CREATE TABLE sweep_scene (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        label TEXT NOT NULL, scene_id TEXT NOT NULL REFERENCES scene (id), defines TEXT NOT NULL,
        position INTEGER NOT NULL, UNIQUE (sweep_id, label));
INSERT INTO "sweep_scene" VALUES('01a20331-9b84-7a66-b479-a13b98eece41','01a20331-9b83-7a2b-b462-2af18dfeac96','box','01a20331-9b51-7092-ae03-96d71461923c','{}',0);
INSERT INTO "sweep_scene" VALUES('01a20331-9d0f-793d-919f-bc35b03c532b','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','box','01a20331-9b51-7092-ae03-96d71461923c','{}',0);
CREATE TABLE target (
        id TEXT PRIMARY KEY, sweep_id TEXT NOT NULL REFERENCES sweep (id) ON DELETE CASCADE,
        device_id TEXT REFERENCES device (id), requires TEXT, position INTEGER NOT NULL);
INSERT INTO "target" VALUES('01a20331-9b88-7054-ad10-6117559693ee','01a20331-9b83-7a2b-b462-2af18dfeac96','01a20331-9b60-7bc9-b64c-a5afb06fcc33',NULL,0);
INSERT INTO "target" VALUES('01a20331-9d12-71c4-b902-4d4aaef90b85','01a20331-9d0e-7d86-8156-a7c29fcd8cd8','01a20331-9b60-7bc9-b64c-a5afb06fcc33',NULL,0);
CREATE TABLE token (
        id TEXT PRIMARY KEY, name TEXT NOT NULL, sha256 TEXT NOT NULL UNIQUE,
        role TEXT NOT NULL CHECK (role IN ('admin', 'operator', 'viewer', 'device')),
        device_id TEXT REFERENCES device (id) ON DELETE CASCADE,
        created_at_us INTEGER NOT NULL, revoked_at_us INTEGER);
INSERT INTO "token" VALUES('01a20331-9b19-75f5-b523-8cbaecf4ceb5','operator','393a6653f04362cb122de1b774c1963610fd4366ea55514f96b0dca5daf6988c','operator',NULL,1795349912345770,NULL);
INSERT INTO "token" VALUES('01a20331-9b1c-7b68-afc3-316aa4d46373','viewer','19c902061f86311aade56f934f0dfad56298593ddcd107c04900572d08f07724','viewer',NULL,1795349912348366,NULL);
INSERT INTO "token" VALUES('01a20331-9b61-7c08-b5cf-91e9e28c6cb9','laptop','47bb69878a633768df4bbe0770964c654352c1f479e379041cd150fe243a5fff','device','01a20331-9b60-7bc9-b64c-a5afb06fcc33',1795349912416791,NULL);
CREATE UNIQUE INDEX "idx__sqlite_migrations_migration_set_name"
    ON "_sqlite_migrations" ("migration_set", "name");
CREATE UNIQUE INDEX device_name ON device (name) WHERE revoked_at_us IS NULL;
CREATE INDEX sweep_state ON sweep (state);
CREATE INDEX target_sweep ON target (sweep_id);
CREATE INDEX job_queue ON job (target_id, state, block, position, id);
CREATE INDEX job_scene ON job (target_id, sweep_scene_id, purpose);
CREATE INDEX job_sweep ON job (sweep_id, state);
CREATE INDEX attempt_expiry ON attempt (expires_at_us) WHERE state = 'leased';
CREATE INDEX attempt_job ON attempt (job_id);
CREATE INDEX result_job ON result (job_id);
CREATE INDEX result_sweep ON result (sweep_id, id);
CREATE INDEX result_image ON result (image_sha256);
CREATE INDEX result_samples ON result (samples_sha256);
CREATE INDEX image_difference_delta ON image_difference (delta_sha256);
CREATE INDEX image_difference_pending ON image_difference (id) WHERE state = 'pending';
CREATE INDEX comparison_sweep ON comparison (sweep_id);
CREATE INDEX comparison_difference ON comparison (difference_id);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('event',19);
COMMIT;
