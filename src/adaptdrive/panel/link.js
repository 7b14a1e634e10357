"use strict";
// The connection to the broker, with the operator's own user: what it may do, the page may do.

const Link = (() => {
  const ANSWER_S = 5;
  const REPEAT_S = 60; // a stop that nobody answers is sent again for so long
  const SILENCE_MS = 10_000; // ten times the longest pause of a drive that is online
  const LONGEST_SILENCE_MS = 300_000;
  const RETRY_MS = 2000;
  const UNSUPPORTED = new Set([1, 0x84]); // unacceptable protocol version, in MQTT 3.1.1 and 5
  const DENIED = new Set([0x80, 0x87]); // MQTT 5: unspecified error, not authorized
  const FORBIDDEN = "This user may look and not command.";
  const UNANSWERED = "No command is answered. Either this user may look and not command (a broker of MQTT 3.1.1 does not say so), " +
    "or the daemon receives no commands: see its event broker, and the access list of the broker.";

  /** @type {any} */ let client = null;
  /** @type {Map<string, (reply: Reply|null) => void>} */ const waiting = new Map();
  /** @type {Map<string, () => void>} */ const unanswered = new Map(); // stops, by id
  /** @type {Set<number>} */ const fleeting = new Set(); // packets that no later connection may carry
  /** @type {Set<() => void>} */ const listeners = new Set();
  /** @type {Set<string>} */ const remembered = new Set(); // drives whose last hour is shown
  let status = "offline";
  let heardMs = 0;
  let patienceMs = SILENCE_MS;
  let problem = "";
  /** @type {Map<string, string>} */ const obstacles = new Map(); // by drive, empty for none; only what an answer shows

  /** Connect and stay connected.
   * @param {{url: string, username: string, password: string}} account @param {4|5} [version] MQTT 3.1.1 or 5
   * @returns {Promise<void>} rejected when the broker refuses the user */
  function open(account, version = 5) {
    close();
    return new Promise((resolve, reject) => {
      client = mqtt.connect(account.url, {
        protocolVersion: version,
        username: account.username || undefined,
        password: account.password || undefined,
        clientId: `adaptdrive-panel-${crypto.getRandomValues(new Uint32Array(2)).join("-")}`,
        clean: true,
        reconnectPeriod: RETRY_MS,
        connectTimeout: 5000,
        keepalive: 15,
        resubscribe: false,
        queueQoSZero: false,
      });
      const own = client;
      own.on("connect", () => {
        own.subscribe(Contract.SUBSCRIPTIONS, { qos: 1 });
        for (const drive of remembered) askHistory(drive);
        obstacles.clear();
        heardMs = performance.now();
        tell("online", "");
        resolve();
      });
      own.on("message", take);
      own.on("close", () => {
        for (const packet of fleeting) own.removeOutgoingMessage(packet);
        fleeting.clear();
        Drives.lose();
        if (status !== "closed") tell("offline", problem);
      });
      own.on("error", (/** @type {any} */ error) => {
        if (version === 5 && UNSUPPORTED.has(error.code)) {
          open(account, 4).then(resolve, reject); // a broker that speaks MQTT 3.1.1 only
          return;
        }
        tell(status, String(error.message ?? error));
        if (refused(error)) {
          close();
          reject(error);
        }
      });
    });
  }

  /** @param {any} error */
  function refused(error) {
    return [4, 5, 0x86, 0x87].includes(error.code);
  }

  function close() {
    status = "closed";
    client?.end(true);
    client = null;
  }

  /** @param {string} topic @param {Uint8Array} payload @param {{retain?: boolean}} packet */
  function take(topic, payload, packet) {
    heardMs = performance.now();
    if (!packet.retain) patienceMs = SILENCE_MS;
    const place = Contract.place(topic);
    if (place?.kind === "reply") {
      const reply = Contract.read(place.kind, payload);
      if (reply) {
        unanswered.get(reply.id)?.();
        waiting.get(reply.id)?.(reply);
      }
    }
    Drives.take(topic, payload, packet.retain === true);
  }

  /** Connect again where a drive that is online is not heard: a broker may leave a socket open and
   * send no more (mosquitto 2.0.11 does after a page has read too slowly). */
  function endSilence() {
    if (status !== "online" || !Drives.expected() || performance.now() - heardMs < patienceMs) return;
    patienceMs = Math.min(2 * patienceMs, LONGEST_SILENCE_MS);
    client.stream.destroy(); // as where a network is lost: `end` would forget a stop that is to be sent again
  }
  window.setInterval(endSilence, RETRY_MS);

  /** Send a command and wait for the daemon's answer. Only a stop is sent again: after a loss of the broker,
   * and while it has no answer, as where the broker took it before the daemon was back. Where no telemetry has
   * told the clock of the drive, nothing but a stop and a ping is sent: it may expire too late.
   * @param {string} drive @param {string} verb @param {unknown} [value] @param {string} [unit] of the value
   * @returns {Promise<{accepted: boolean, text: string}>} what the daemon said, or that it did not */
  function ask(drive, verb, value, unit) {
    const now = clockMs(drive) ?? (verb === "ping" ? Date.now() : null);
    if (now === null && verb !== "disable") return Promise.resolve({ accepted: false, text: "not sent: the drive is not heard" });
    const expires = verb === "disable" || now === null ? {} : { expires: new Date(now + 1000 * ANSWER_S).toISOString() };
    const content = { ...(value === undefined ? {} : { value }), ...(unit === undefined ? {} : { unit }), ...expires };
    return request(Contract.command(drive, verb), content, verb === "disable");
  }

  /** Disturb a simulated device and wait for its answer.
   * @param {string} drive @param {Record<string, number>} content */
  function disturb(drive, content) {
    return request(Contract.disturb(drive), content);
  }

  /** @param {string} topic @param {Record<string, unknown>} content
   * @param {boolean} [again] whether it is sent again where the connection is lost
   * @returns {Promise<{accepted: boolean, text: string}>} */
  function request(topic, content, again = false) {
    const id = `panel-${crypto.getRandomValues(new Uint32Array(3)).join("-")}`;
    const payload = JSON.stringify({ ...content, id });
    return new Promise((resolve) => {
      const end = (/** @type {boolean} */ accepted, /** @type {string} */ text) => {
        clearTimeout(timer);
        waiting.delete(id);
        resolve({ accepted, text });
      };
      const timer = setTimeout(() => end(false, `no answer within ${ANSWER_S} s`), 1000 * ANSWER_S);
      waiting.set(id, (reply) => end(reply?.accepted === true, reply?.accepted ? "accepted" : `refused: ${reply?.reason}`));
      if (!client?.connected) return end(false, "not sent: no broker");
      let number = 0; // no packet's, as long as it is not known
      client.publish(topic, payload, { qos: 1 }, (/** @type {any} */ error, /** @type {any} */ packet) => {
        const code = packet?.reasonCode ?? error?.code;
        fleeting.delete(number);
        if (error || DENIED.has(code)) end(false, DENIED.has(code) ? "not allowed for this user" : "no answer: the connection to the broker was lost");
      });
      number = client.getLastMessageId();
      if (again) repeat(topic, payload, id);
      else fleeting.add(number);
    });
  }

  /** Send a stop again, under its own id, until it is answered. The daemon acts once on an id.
   * @param {string} topic @param {string} payload @param {string} id */
  function repeat(topic, payload, id) {
    const own = client;
    const end = () => { clearInterval(timer); unanswered.delete(id); };
    const timer = setInterval(() => {
      if (own === client && own.connected) own.publish(topic, payload, { qos: 1 });
    }, 1000 * ANSWER_S);
    unanswered.set(id, end);
    setTimeout(end, 1000 * REPEAT_S);
  }

  /** Ask for the last hour of a drive, now and after each loss of the broker. @param {string} drive */
  function askHistory(drive) {
    remembered.add(drive);
    const { ask, answer } = Contract.history(drive);
    client?.subscribe(answer, { qos: 1 });
    client?.publish(ask, "", { qos: 1 });
  }

  /** The drive's clock now, null as long as it is not known. @param {string} drive */
  function clockMs(drive) {
    const view = Drives.named(drive);
    return view.heard && Number.isFinite(view.clockS) ? 1000 * (view.clockS + view.ageS) : null;
  }

  /** Find out why no command of this user is answered, by a request that does nothing.
   * @param {string} drive
   * @returns {Promise<string|null>} empty where one is, UNANSWERED as long as none is, null while it is not known */
  async function obstacle(drive) {
    const known = obstacles.get(drive);
    if (known !== undefined) return known;
    const { text } = await ask(drive, "ping");
    if (text.startsWith("not sent")) return null;
    if (text.startsWith("no answer")) return Drives.named(drive).live ? UNANSWERED : null;
    const found = text.startsWith("not allowed") ? FORBIDDEN : "";
    obstacles.set(drive, found);
    return found;
  }

  /** @param {string} now @param {string} why */
  function tell(now, why) {
    status = now;
    problem = why;
    for (const listener of listeners) listener();
  }

  return {
    UNANSWERED, open, close, ask, disturb, askHistory, obstacle,
    /** @param {() => void} listener */ watch: (listener) => listeners.add(listener),
    get online() { return status === "online"; },
    get problem() { return problem; },
  };
})();
