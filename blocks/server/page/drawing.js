/** The drawing of the open level. */
export function start(app) {
  const place = document.getElementById("drawing");
  app.on("document", async () => {
    const { level, svg } = app.state;
    app.state.svg = "";
    place.innerHTML = svg || (await app.connection.ask("draw", { level })).svg; // made and escaped by the server
  });
}
