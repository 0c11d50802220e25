/** The run: buttons, and how it stands. */
export function start(app) {
  const bar = document.getElementById("runbar");
  const button = (text, action) => {
    const made = document.createElement("button");
    made.textContent = text;
    made.onclick = () => app.connection.ask(action()).catch((error) => app.announce(error.message));
    bar.append(made);
    return made;
  };
  const state = () => app.state.run?.state;
  button("Run", () => (state() === "paused" ? "resume" : "run"));
  button("Pause", () => "pause");
  button("Step", () => "step");
  button("Stop", () => "stop");
  const told = document.createElement("output");
  bar.append(told);
  app.on("run", (run) => (told.textContent = run.state === "none" ? "" : `${run.state} t = ${run.t.toPrecision(6)} s`));
}
